"""Solve stage 1: poses, shape and camera of a video from a network's landmarks.

:func:`solve_stage1` minimises ``evidence + prior``, in nats, over all frames together. The evidence
is :mod:`gva_mi.stage1.evidence`, the prior :mod:`gva_mi.stage1.body_prior`. Errors have heavy
tails: each residual is squared and reweighted by its size (iteratively reweighted least squares).

Body and palms are solved first, then the fingers of each hand. Frames without landmarks, and hands
that were not found, follow from their neighbours and the prior.

Landmarks do not show how stout a person is, so betas stay near the mean except for lengths.
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
from gva_mi.body.pose import HANDS, JOINTS, LEFT_HAND, SMPLX_EXPRESSIONS, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress
from gva_mi.core.cpu import one_torch_thread
from gva_mi.core.tasks import on_all_cores
from gva_mi.observe.landmark_noise import (
    REFERENCE_HEIGHT,
    LandmarkNoise,
    correlated_frames,
    median_sizes,
    person_sizes,
)
from gva_mi.observe.rig import LandmarkRig
from gva_mi.prior.anatomy import Anatomy
from gva_mi.prior.body_height import Stature
from gva_mi.splat import Camera
from gva_mi.stage1.arm_depths import with_arm_depths
from gva_mi.stage1.body_prior import (
    AVERAGE_HEIGHT,
    UNKNOWN_FOCAL_SIGMA,
    BodyPrior,
    SharedPrior,
    Smoothness,
    angles_of,
    relaxed_pose,
)
from gva_mi.stage1.evidence import LandmarkEvidence, landmark_evidence
from gva_mi.stage1.normal_equations import FRAMES_AT_ONCE, NormalEquations
from gva_mi.stage1.unknowns import Stage1State, Unknowns
from gva_mi.stage1.vertical_lines import Vertical
from gva_mi.subject.landmarks import Landmarks
from gva_mi.subject.lens import centred, in_pixels

# Focal length of an unknown camera, mm of 35 mm film: main cameras of phones have 24 to 28.
PHONE_FOCAL_35MM = 26.0
KNOWN_FOCAL_SIGMA = 1e-4  # of the logarithm of a known focal length; chosen: it hardly moves
START_STEPS, BODY_STEPS, HAND_STEPS = 8, 30, 15  # Levenberg-Marquardt steps, at most; by eye
CONVERGED_DECREASE = 1e-4  # relative decrease of the energy that ends the steps; by eye
# Levenberg-Marquardt damping, relative to the diagonal: first, as in Numerical Recipes, and
# range. Chosen: from Gauss-Newton's steps to hardly any.
FIRST_DAMPING, SMALLEST_DAMPING, LARGEST_DAMPING = 1e-3, 1e-8, 1e6
# Factors on the damping after a step that lowers the energy, and after one that does not; by eye.
DAMPING_AFTER_SUCCESS, DAMPING_AFTER_FAILURE = 0.2, 6.0
_PALM_POINTS = ("hand_wrist", "thumb_cmc", "index_mcp", "middle_mcp", "ring_mcp", "pinky_mcp")
_FACE_JOINTS = ("jaw", "left_eye_smplhf", "right_eye_smplhf")
_BODY_JOINTS = [k for k, name in enumerate(JOINTS[: LEFT_HAND.start]) if name not in _FACE_JOINTS]


@dataclass(frozen=True)
class Stage1Solution:
    """Stage 1 of a video of T frames, in a world with y up and the floor at y = 0."""

    pose: Pose
    shape: Shape
    camera: Camera
    tilt: float  # degrees that the camera looks down


@dataclass(frozen=True)
class KnownParameters:
    """Known parameters of a video; None means unknown.

    Attributes:
        height: of the person, metres. None: an average height, so size and distance are uncertain
            by 5 %. It is not fitted: networks underestimate depths, which would shrink the person.
        focal: focal length, pixels. None: fitted, with a prior around the main cameras of phones.
        lines: the upward direction, estimated from vertical lines of the room with this focal
            length, or with :data:`PHONE_FOCAL_35MM`.
        camera_height: of the lens above the floor, metres.
    """

    height: float | None = None
    focal: float | None = None
    lines: Vertical | None = None
    camera_height: float | None = None

    def K(self, size: tuple[int, int]) -> np.ndarray:
        """Return the initial intrinsics K (3, 3) for pictures of ``size`` (width, height)."""
        return centred(self.focal or in_pixels(PHONE_FOCAL_35MM, size), size)


def solve_stage1(
    landmarks: Landmarks,
    body: BodyModel,
    size: tuple[int, int],
    fps: float,
    known: KnownParameters = KnownParameters(),  # noqa: B008 (frozen)
    progress: Progress | None = None,
) -> Stage1Solution:
    """Find poses, shape and camera of one person before a camera that stands still.

    Args:
        landmarks: T frames.
        body: SMPL-X or the built-in body.
        size: width and height of the pictures, pixels.
        fps: frames a second.
        known: known parameters of the video.
        progress: called as ``progress(done, total)``.

    Raises:
        InputError: no frame has a person.
    """
    report = progress or (lambda done, total, **figures: None)
    with one_torch_thread(), torch.no_grad():
        problems = _ProblemFactory(landmarks, body, size, fps, known)
        state = problems.initial_state()
        state = problems.body_problem(state, starting=True).minimised(state, START_STEPS)
        report(1, 4)
        problem = problems.body_problem(state)
        state = problem.minimised(state, BODY_STEPS)
        state = problems.with_arm_depths(problem, state).minimised(state, BODY_STEPS)
        report(2, 4)
        for k, side in enumerate(HANDS):
            state = problems.hand_problem(state, side).minimised(state, HAND_STEPS)
            report(3 + k, 4)
        return problems.result(state)


@dataclass(frozen=True)
class Stage1Problem:
    """Least-squares problem over a subset of the unknowns.

    Attributes:
        unknowns: to solve for.
        landmark_indices: the video's landmarks that the evidence compares.
        evidence, prior, shared_prior, smoothness: terms of the energy.
    """

    unknowns: Unknowns
    landmark_indices: Sequence[int]
    evidence: LandmarkEvidence
    prior: BodyPrior
    shared_prior: SharedPrior
    smoothness: Smoothness

    def minimised(self, state: Stage1State, steps: int) -> Stage1State:
        """Minimise the energy from a state; take ``steps`` at most."""
        landmark_indices, offsets = list(self.landmark_indices), state.offsets
        state = replace(state, offsets=offsets[landmark_indices])
        damping, energy = FIRST_DAMPING, float(self.energy(state))
        for _ in range(steps):
            equations, before = self.equations(state), energy
            while damping < LARGEST_DAMPING:
                trial = self.unknowns.moved(state, *equations.solve(damping))
                found = float(self.energy(trial))
                if found < energy:
                    break
                damping *= DAMPING_AFTER_FAILURE
            else:
                break
            state, energy = trial, found
            damping = max(damping * DAMPING_AFTER_SUCCESS, SMALLEST_DAMPING)
            if before - energy < CONVERGED_DECREASE * abs(before):
                break
        whole = offsets.clone()
        whole[landmark_indices] = state.offsets
        return replace(state, offsets=whole)

    def energy(self, state: Stage1State) -> Tensor:
        """Return the sum of all terms, nats."""
        total = self.prior.energy(state) + self.smoothness.energy(state)
        total = total + self.shared_prior.energy(state)
        return total + sum(row.energy for row in self.evidence.rows(state, derive=False))

    def equations(self, state: Stage1State) -> NormalEquations:
        """Return the normal equations around a state."""
        count, F = len(state.pelvis_position), self.unknowns.per_frame
        equations = NormalEquations.zero(count, F, self.unknowns.shared)

        def added(start: int) -> list[tuple[Tensor, Tensor] | None]:
            some = slice(start, start + FRAMES_AT_ONCE)
            rotations, place = state.rotations[some], state.pelvis_position[some]
            part = replace(state, rotations=rotations, pelvis_position=place)
            rows = self.evidence.of(some).rows(part, derive=True)
            slopes = lambda row: (row.jacobian[..., :F], row.jacobian[..., F:])
            return [
                equations.add_to_frames(some, row.residuals, row.weights, *slopes(row))
                for row in rows
            ]

        for shared in on_all_cores(added, range(0, count, FRAMES_AT_ONCE)):
            for terms in shared:
                equations.add_shared(terms)
        for row in self.prior.rows(state):
            slopes = (x.expand(count, *x.shape) for x in (row.by_frame, row.by_shared))
            equations.add(slice(None), row.residuals, row.weights, *slopes)
        self.smoothness.add(state, equations)
        self.shared_prior.add(state, equations)
        return equations


class _ProblemFactory:
    """A video's data, from which the problems of stage 1 are built."""

    def __init__(
        self,
        landmarks: Landmarks,
        body: BodyModel,
        size: tuple[int, int],
        fps: float,
        known: KnownParameters,
    ) -> None:
        self.body, self.size, self.dt, self.known = body, size, 1 / fps, known
        self.rig = LandmarkRig.of(body, sorted(landmarks.names), landmarks.at_joints)
        at, names = landmarks.indices(self.rig.names), ("pixels", "confidence", "spread", "metric")
        arrays = {name: getattr(landmarks, name)[:, at] for name in names}
        self.landmarks = Landmarks(self.rig.names, **arrays, at_joints=landmarks.at_joints)
        self.anatomy, self.K = Anatomy.of(body.j_template), known.K(size)
        self.stature = Stature.of(body)
        usual = AVERAGE_HEIGHT if self.stature.slope.any() else self.stature.mean
        self.height = known.height or usual

    def initial_state(self) -> Stage1State:
        """Return the initial guess: relaxed joints, with the root placed at the observed hips."""
        shape = self.mean_shape()
        scale = self.rig.scale(self.landmarks, shape.betas)
        # Raises an InputError if no frame has a person.
        pelvis_position = initial_pelvis_position(self.landmarks, self.K, scale)
        rotations = relaxed_pose(self.anatomy).repeat(len(self.landmarks), 1, 1)
        rotations[:, 0] = so3.to_rotvec(initial_root(self.landmarks))
        zero = lambda *shape: torch.zeros(shape, dtype=torch.float64)
        return Stage1State(
            rotations=rotations,
            pelvis_position=pelvis_position,
            betas=shape.betas.double(),
            log_focal_scale=zero(),
            up=zero(2),
            floor=pelvis_position[:, 1].median() + 0.5 * self.height,
            offsets=zero(len(self.rig.names), 3),
            angle_offsets=zero(len(self.anatomy.spreads)),
        )

    def mean_shape(self) -> Shape:
        """Return the mean person of the known or usual height."""
        mean = Shape(self.body.v_template.new_zeros(self.body.num_betas))
        return self.stature.nearest(mean, self.height)

    def body_problem(self, state: Stage1State, starting: bool = False) -> Stage1Problem:
        """Return the problem of body and palms; the starting problem has no shared unknowns."""
        names = self.rig.names
        landmark_indices = [
            p for p, name in enumerate(names) if "_hand_" not in name or name.endswith(_PALM_POINTS)
        ]
        if starting:
            problem = self._problem(Unknowns(_BODY_JOINTS), landmark_indices, state)
            return replace(problem, evidence=replace(problem.evidence, starting=True))
        offsets, angles = range(len(landmark_indices)), angles_of(self.anatomy, _BODY_JOINTS)
        unknowns = Unknowns(_BODY_JOINTS, len(state.betas), True, offsets, angles)
        return self._problem(unknowns, landmark_indices, state)

    def with_arm_depths(self, problem: Stage1Problem, state: Stage1State) -> Stage1Problem:
        """Return the problem with depths of arms inferred from all frames, around a solution."""
        landmark_indices = list(problem.landmark_indices)
        names = [self.rig.names[p] for p in landmark_indices]
        state = replace(state, offsets=state.offsets[landmark_indices])
        return replace(problem, evidence=with_arm_depths(problem.evidence, names, state, self.dt))

    def hand_problem(self, state: Stage1State, side: str) -> Stage1Problem:
        """Return the problem of one hand's fingers."""
        joints = range(len(JOINTS))[HANDS[side]]
        names = self.rig.names
        landmark_indices = [p for p, name in enumerate(names) if f"{side}_hand_" in name]
        of_fingers = [
            k for k, p in enumerate(landmark_indices) if not names[p].endswith(_PALM_POINTS)
        ]
        unknowns = Unknowns(joints, 0, False, of_fingers, angles_of(self.anatomy, joints))
        return self._problem(unknowns, landmark_indices, state, side)

    def _problem(
        self,
        unknowns: Unknowns,
        landmark_indices: Sequence[int],
        state: Stage1State,
        hand: str | None = None,
    ) -> Stage1Problem:
        names = [self.rig.names[p] for p in landmark_indices]
        rig = LandmarkRig.of(self.body, names, self.landmarks.at_joints)
        at = self.landmarks.indices(rig.names)
        scale = self.rig.scale(self.landmarks, state.betas.float())
        correlated = correlated_frames(self.landmarks, self.dt, hand)
        evidence = landmark_evidence(
            self.body,
            rig,
            unknowns,
            pixels=torch.from_numpy(self.landmarks.pixels[:, at]),
            metric=scale * torch.from_numpy(self.landmarks.metric[:, at]),
            noise=LandmarkNoise.of(self.landmarks, rig.names),
            K=torch.from_numpy(self.K),
            correlated=correlated,
        )
        constant = torch.tensor([spread.constant for spread in self.anatomy.spreads]).double()
        known = self.known
        shared = SharedPrior(
            unknowns=unknowns,
            names=rig.names,
            offset_spread=rig.offset_spread,
            angle_sigma=torch.deg2rad(constant),
            betas=self.mean_shape().betas.double(),
            stature=self.stature,
            height=self.height,
            focal_sigma=KNOWN_FOCAL_SIGMA if known.focal else UNKNOWN_FOCAL_SIGMA,
            lines=known.lines,
            camera_height=known.camera_height,
        )
        prior = BodyPrior.of(unknowns, self.anatomy, correlated)
        smoothness = Smoothness(unknowns, self.dt)
        return Stage1Problem(unknowns, landmark_indices, evidence, prior, shared, smoothness)

    def result(self, state: Stage1State) -> Stage1Solution:
        """Return the solution in a world with y up and the floor at zero, below the person."""
        up, _ = state.upward()
        x = torch.tensor([1.0, 0, 0], dtype=up.dtype)
        x = normalize(x - (x @ up) * up, dim=0)
        R_camera_world = torch.stack([x, up, torch.linalg.cross(x, up)], 1)
        middle = state.pelvis_position.mean(0)
        origin = middle - (up @ middle + state.floor) * up
        rotations = state.rotations.clone()
        rotations[:, 0] = so3.to_rotvec(R_camera_world.T @ so3.to_matrix(rotations[:, 0]))
        shape = Shape(state.betas.float())
        pelvis_position = (state.pelvis_position - origin) @ R_camera_world
        transl = pelvis_position - self.body.rest(shape).joints[0].double()
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R_camera_world.numpy(), origin.numpy()
        zoom = float(state.log_focal_scale.exp())
        camera = Camera.from_matrices(self.K, T, *self.size).zoomed(zoom)
        pose = Pose(rotations.float(), transl.float(), torch.zeros(len(transl), SMPLX_EXPRESSIONS))
        return Stage1Solution(pose, shape, camera, tilt=-math.degrees(math.asin(float(up[2]))))


def initial_root(landmarks: Landmarks) -> Tensor:
    """Return rotations (T, 3, 3) from the body's axes to the camera's, by landmarks of the trunk.

    Frames without a trunk take the nearest frame's.
    """
    at = landmarks.indices(["left_shoulder", "right_shoulder", "left_hip", "right_hip"])
    trunk = torch.from_numpy(landmarks.metric[:, at]).double()
    left_shoulder, right_shoulder, left_hip, right_hip = trunk.unbind(1)
    up = left_shoulder + right_shoulder - left_hip - right_hip
    lateral = left_shoulder - right_shoulder + left_hip - right_hip
    y = normalize(up, dim=1)
    x = normalize(lateral - (lateral * y).sum(1, keepdim=True) * y, dim=1)
    R = torch.stack([x, y, torch.linalg.cross(x, y)], dim=2)
    return R[_nearest(R.flatten(1).isfinite().all(1).numpy())]


def initial_pelvis_position(landmarks: Landmarks, K: np.ndarray, scale: float) -> Tensor:
    """Return the positions (T, 3) of the hips' centre in the camera's axes, metres.

    Distance follows from the person's size in the picture. Frames without hips take the nearest
    frame's.

    Args:
        landmarks: of T frames.
        K: (3, 3) the camera, pixels.
        scale: of the body relative to the landmarks' metres.
    """
    size = median_sizes(person_sizes(landmarks))
    z = (K[0, 0] + K[1, 1]) / 2 * REFERENCE_HEIGHT * scale / size
    hips = landmarks.pixels[:, landmarks.indices(["left_hip", "right_hip"])].mean(1)
    rays = (hips - K[:2, 2]) / [K[0, 0], K[1, 1]]
    centres = np.concatenate([rays, np.ones_like(rays[:, :1])], axis=1) * z[:, None]
    return torch.from_numpy(centres[_nearest(np.isfinite(rays).all(1))])


def _nearest(known: np.ndarray) -> list[int]:
    """Return the nearest known frame of every frame; ``known`` (T,) is bool."""
    some = np.flatnonzero(known)
    return [int(some[np.abs(some - t).argmin()]) for t in range(len(known))]
