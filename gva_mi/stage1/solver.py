"""Stage 1 of a video: poses, shape and camera from a network's landmarks.

:func:`solve_stage1` minimises ``evidence + prior``, in nats, over all frames together. Evidence is
:mod:`gva_mi.stage1.evidence`; the prior is :mod:`gva_mi.stage1.body_prior` and
:mod:`gva_mi.stage1.body_prior`. Errors have heavy tails: each is a square whose weight follows
the error (iteratively reweighted least squares).

Body and palms are solved first, then the fingers of each hand. Frames without landmarks, and hands
that were not found, follow from their neighbours and the prior.

Landmarks do not show how stout a person is: betas stay near the mean except for lengths.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

from gva_mi.body import so3
from gva_mi.body.pose import HANDS, JOINTS, LEFT_HAND, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress
from gva_mi.core.cpu import one_torch_thread
from gva_mi.observe.landmark_noise import PERSON, LandmarkNoise, correlated_frames, person_sizes
from gva_mi.observe.rig import LandmarkRig
from gva_mi.prior.anatomy import Anatomy
from gva_mi.prior.stature import Stature
from gva_mi.splat import Camera
from gva_mi.stage1.arm_depths import with_arm_depths
from gva_mi.stage1.body_prior import (
    FOCAL,
    HEIGHT,
    BodyPrior,
    SharedPrior,
    Smoothness,
    angles_of,
    relaxed_pose,
)
from gva_mi.stage1.evidence import LandmarkEvidence, landmark_evidence
from gva_mi.stage1.normal_equations import FRAMES_AT_ONCE, Free, NormalEquations, Stage1State
from gva_mi.stage1.upright import Vertical
from gva_mi.subject.landmarks import Landmarks
from gva_mi.subject.lens import centred, in_pixels

LENS = 26.0  # mm of 35 mm film, of an unknown camera: main cameras of phones have 24 to 28
FOCAL_KNOWN = 1e-4  # of its logarithm
START_STEPS, BODY_STEPS, HAND_STEPS = 8, 30, 15  # steps, at most
_PALM = ("hand_wrist", "thumb_cmc", "index_mcp", "middle_mcp", "ring_mcp", "pinky_mcp")
_FACE = ("jaw", "left_eye_smplhf", "right_eye_smplhf")
_BODY = [k for k, name in enumerate(JOINTS[: LEFT_HAND.start]) if name not in _FACE]
LEAST_GAIN = 1e-4  # of the energy; a smaller gain ends the steps
DAMPING, LEAST_DAMPING, LARGEST_DAMPING = 1e-3, 1e-8, 1e6
AFTER_SUCCESS, AFTER_FAILURE = (
    0.2,
    6.0,
)  # factors on the damping after a step that succeeds, and one that fails
_MEDIAN_FRAMES = 5  # frames to each side, of a median


@dataclass(frozen=True)
class Stage1Solution:
    """Stage 1 of a video of T frames, in a world with y up and the floor at y = 0."""

    pose: Pose
    shape: Shape
    camera: Camera
    tilt: float  # degrees that the camera looks down


@dataclass(frozen=True)
class KnownOfVideo:
    """What is known of a video beforehand; None: unknown.

    Attributes:
        height: of the person, metres; without it that of an average one, so size and distance are
            uncertain by 5 %. It is not found: depths that networks take for smaller than they are
            would shrink the person.
        focal: focal length, pixels; without it a prior around the main cameras of phones.
        lines: the direction up by lines of the room, for that focal length or for :data:`LENS`.
        camera_height: of the lens above the floor, metres.
    """

    height: float | None = None
    focal: float | None = None
    lines: Vertical | None = None
    camera_height: float | None = None

    def K(self, size: tuple[int, int]) -> np.ndarray:
        """Return the camera to start from, for pictures of a width and height, pixels."""
        return centred(self.focal or in_pixels(LENS, size), size)


def solve_stage1(
    landmarks: Landmarks,
    body: BodyModel,
    size: tuple[int, int],
    fps: float,
    known: KnownOfVideo = KnownOfVideo(),  # noqa: B008 (frozen)
    progress: Progress | None = None,
) -> Stage1Solution:
    """Find poses, shape and camera of one person before a camera that stands still.

    Args:
        landmarks: T frames.
        body: SMPL-X's or the built-in one.
        size: width and height of the pictures, pixels.
        fps: frames a second.
        known: beforehand.
        progress: called as ``progress(done, total)``.

    Raises:
        InputError: no frame has a person.
    """
    report = progress or (lambda done, total, **figures: None)
    with one_torch_thread(), torch.no_grad():
        recording = _Observed(landmarks, body, size, fps, known)
        state = recording.first()
        state = recording.body_problem(state, starting=True).minimised(state, START_STEPS)
        report(1, 4)
        problem = recording.body_problem(state)
        state = problem.minimised(state, BODY_STEPS)
        state = recording.with_arm_depths(problem, state).minimised(state, BODY_STEPS)
        report(2, 4)
        for k, side in enumerate(HANDS):
            state = recording.hand_problem(state, side).minimised(state, HAND_STEPS)
            report(3 + k, 4)
        return recording.result(state)


@dataclass(frozen=True)
class Stage1Problem:
    """Terms over the same unknowns.

    Attributes:
        free: the unknowns.
        which: of the video's landmarks, those that are compared.
        evidence, prior, shared_prior, smoothness: the terms.
    """

    free: Free
    which: Sequence[int]
    evidence: LandmarkEvidence
    prior: BodyPrior
    shared_prior: SharedPrior
    smoothness: Smoothness

    def minimised(self, state: Stage1State, steps: int) -> Stage1State:
        """Take at most some steps."""
        which, offsets = list(self.which), state.offsets
        state = replace(state, offsets=offsets[which])
        damping, energy = DAMPING, float(self.energy(state))
        for _ in range(steps):
            equations, before = self.equations(state), energy
            while damping < LARGEST_DAMPING:
                trial = self.free.moved(state, *equations.solve(damping))
                found = float(self.energy(trial))
                if found < energy:
                    break
                damping *= AFTER_FAILURE
            else:
                break
            state, energy, damping = trial, found, max(damping * AFTER_SUCCESS, LEAST_DAMPING)
            if before - energy < LEAST_GAIN * abs(before):
                break
        whole = offsets.clone()
        whole[which] = state.offsets
        return replace(state, offsets=whole)

    def energy(self, state: Stage1State) -> Tensor:
        """Return the sum of all terms, nats."""
        total = self.prior.energy(state) + self.smoothness.energy(state)
        total = total + self.shared_prior.energy(state)
        return total + sum(row.energy for row in self.evidence.rows(state, derive=False))

    def equations(self, state: Stage1State) -> NormalEquations:
        """Return the normal equations around a state."""
        count, F = len(state.place), self.free.per_frame
        equations = NormalEquations.zero(count, F, self.free.shared)
        for start in range(0, count, FRAMES_AT_ONCE):
            some = slice(start, start + FRAMES_AT_ONCE)
            part = replace(state, rotations=state.rotations[some], place=state.place[some])
            for row in self.evidence.of(some).rows(part, derive=True):
                by_frame, by_shared = row.jacobian[..., :F], row.jacobian[..., F:]
                equations.add(some, row.residuals, row.weights, by_frame, by_shared)
        for row in self.prior.rows(state):
            shape = (count, *row.by_frame.shape), (count, *row.by_shared.shape)
            by_frame, by_shared = row.by_frame.expand(shape[0]), row.by_shared.expand(shape[1])
            equations.add(slice(None), row.residuals, row.weights, by_frame, by_shared)
        self.smoothness.add(state, equations)
        self.shared_prior.add(state, equations)
        return equations


class _Observed:
    """A video to solve."""

    def __init__(
        self,
        landmarks: Landmarks,
        body: BodyModel,
        size: tuple[int, int],
        fps: float,
        known: KnownOfVideo,
    ) -> None:
        self.body, self.size, self.dt, self.known = body, size, 1 / fps, known
        self.rig = LandmarkRig.of(body, sorted(landmarks.names))
        at, names = landmarks.indices(self.rig.names), ("pixels", "confidence", "spread", "metric")
        arrays = {name: getattr(landmarks, name)[:, at] for name in names}
        self.landmarks = Landmarks(self.rig.names, **arrays)
        self.anatomy, self.K = Anatomy.of(body.j_template), known.K(size)

    def first(self) -> Stage1State:
        """Return the first guess: relaxed joints, the body at its place."""
        shape = self.mean_shape()
        scale = self.rig.scale(self.landmarks, shape.betas)
        place = first_place(self.landmarks, self.K, scale)  # first, as it refuses a video of nobody
        rotations = relaxed_pose(self.anatomy).repeat(len(self.landmarks), 1, 1)
        rotations[:, 0] = so3.to_rotvec(first_root(self.landmarks))
        zero = lambda *shape: torch.zeros(shape, dtype=torch.float64)
        up = zero(2)
        floor = place[:, 1].median() + 0.5 * (self.known.height or HEIGHT)
        angle_offsets = zero(len(self.anatomy.freedoms))
        offsets = zero(len(self.rig.names), 3)
        shared = shape.betas.double(), zero(), up, floor, offsets, angle_offsets
        return Stage1State(rotations, place, *shared)

    def mean_shape(self) -> Shape:
        """Return the mean person of the given height."""
        mean = Shape(self.body.v_template.new_zeros(self.body.num_betas))
        return Stature.of(self.body).nearest(mean, self.known.height or HEIGHT)

    def body_problem(self, state: Stage1State, starting: bool = False) -> Stage1Problem:
        """Return the problem of body and palms; the starting one has no shared unknowns."""
        names = self.rig.names
        which = [p for p, name in enumerate(names) if "_hand_" not in name or name.endswith(_PALM)]
        if starting:
            problem = self._problem(Free(_BODY), which, state)
            return replace(problem, evidence=replace(problem.evidence, starting=True))
        angle_offsets = angles_of(self.anatomy, _BODY)
        free = Free(_BODY, len(state.betas), True, range(len(which)), angle_offsets)
        return self._problem(free, which, state)

    def with_arm_depths(self, problem: Stage1Problem, state: Stage1State) -> Stage1Problem:
        """Return the problem with the arms' depths as all frames see them, around a solution."""
        which = list(problem.which)
        names = [self.rig.names[p] for p in which]
        state = replace(state, offsets=state.offsets[which])
        return replace(problem, evidence=with_arm_depths(problem.evidence, names, state, self.dt))

    def hand_problem(self, state: Stage1State, side: str) -> Stage1Problem:
        """Return the problem of one hand's fingers."""
        joints = range(len(JOINTS))[HANDS[side]]
        which = [p for p, name in enumerate(self.rig.names) if f"{side}_hand_" in name]
        of_fingers = [k for k, p in enumerate(which) if not self.rig.names[p].endswith(_PALM)]
        free = Free(joints, 0, False, of_fingers, angles_of(self.anatomy, joints))
        return self._problem(free, which, state, side)

    def _problem(
        self, free: Free, which: Sequence[int], state: Stage1State, hand: str | None = None
    ) -> Stage1Problem:
        rig = LandmarkRig.of(self.body, [self.rig.names[p] for p in which])
        noise = LandmarkNoise.of(self.landmarks, rig.names)
        at = self.landmarks.indices(rig.names)
        pixels = torch.from_numpy(self.landmarks.pixels[:, at])
        scale = self.rig.scale(self.landmarks, state.betas.float())
        metric = scale * torch.from_numpy(self.landmarks.metric[:, at])
        correlated, K = correlated_frames(self.landmarks, self.dt, hand), torch.from_numpy(self.K)
        evidence = landmark_evidence(self.body, rig, free, (pixels, metric, noise), K, correlated)
        prior = BodyPrior.of(free, self.anatomy, correlated)
        always = torch.tensor([f.always for f in self.anatomy.freedoms]).double()
        known = self.known
        shared = SharedPrior(
            free,
            rig.names,
            rig.offset_spread,
            torch.deg2rad(always),
            self.mean_shape().betas.double(),
            Stature.of(self.body),
            known.height or HEIGHT,
            FOCAL_KNOWN if known.focal else FOCAL,
            known.lines,
            known.camera_height,
        )
        return Stage1Problem(free, which, evidence, prior, shared, Smoothness(free, self.dt))

    def result(self, state: Stage1State) -> Stage1Solution:
        """Turn the world upright, with the floor at zero below the person."""
        up, _ = state.upward()
        x = torch.tensor([1.0, 0, 0], dtype=up.dtype)
        x = torch.nn.functional.normalize(x - (x @ up) * up, dim=0)
        R_camera_world = torch.stack([x, up, torch.linalg.cross(x, up)], 1)
        middle = state.place.mean(0)
        origin = middle - (up @ middle + state.floor) * up
        rotations = state.rotations.clone()
        root = R_camera_world.T @ so3.to_matrix(rotations[:, 0])
        rotations[:, 0] = so3.to_rotvec(root)
        shape = Shape(state.betas.float())
        place = (state.place - origin) @ R_camera_world
        transl = place - self.body.rest(shape).joints[0].double()
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R_camera_world.numpy(), origin.numpy()
        camera = Camera.from_matrices(self.K, T, *self.size).zoomed(float(state.focal.exp()))
        pose = Pose(rotations.float(), transl.float(), torch.zeros(len(transl), 10))
        return Stage1Solution(pose, shape, camera, tilt=-math.degrees(math.asin(float(up[2]))))


def first_root(landmarks: Landmarks) -> Tensor:
    """Return rotations (T, 3, 3) from the body's axes to the camera's, from the trunk's landmarks.

    Frames without a trunk take the nearest frame's.
    """
    at = landmarks.indices(["left_shoulder", "right_shoulder", "left_hip", "right_hip"])
    trunk = torch.from_numpy(landmarks.metric[:, at]).double()
    left_shoulder, right_shoulder, left_hip, right_hip = trunk.unbind(1)
    up = left_shoulder + right_shoulder - left_hip - right_hip
    aside = left_shoulder - right_shoulder + left_hip - right_hip
    y = normalize(up, dim=1)
    x = normalize(aside - (aside * y).sum(1, keepdim=True) * y, dim=1)
    R = torch.stack([x, y, torch.linalg.cross(x, y)], dim=2)
    return R[_nearest(R.flatten(1).isfinite().all(1).numpy())]


def first_place(landmarks: Landmarks, K: np.ndarray, scale: float) -> Tensor:
    """Return where the hips are, (T, 3) metres in the camera's axes.

    The distance is that at which a person has the size seen. ``K`` (3, 3) is the camera, ``scale``
    the body's size relative to the landmarks' metres. Frames without hips take the nearest frame's.
    """
    size = person_sizes(landmarks)
    around = [size[max(0, t - _MEDIAN_FRAMES) : t + _MEDIAN_FRAMES + 1] for t in range(len(size))]
    focal = (K[0, 0] + K[1, 1]) / 2
    z = focal * PERSON * scale / np.array([np.median(some) for some in around])
    hips = landmarks.pixels[:, landmarks.indices(["left_hip", "right_hip"])].mean(1)
    rays = (hips - K[:2, 2]) / [K[0, 0], K[1, 1]]
    place = np.concatenate([rays, np.ones_like(rays[:, :1])], axis=1) * z[:, None]
    return torch.from_numpy(place[_nearest(np.isfinite(rays).all(1))])


def _nearest(known: np.ndarray) -> list[int]:
    """Return of every frame the nearest one that is known."""
    some = np.flatnonzero(known)
    return [int(some[np.abs(some - t).argmin()]) for t in range(len(known))]
