"""Stage 1 of a film: poses, shape and camera from a network's landmarks.

:func:`solve_film` minimises ``evidence + prior``, in nats, over all frames together. Evidence is
:mod:`gva_mi.pose.film.film_evidence`; the prior is :mod:`gva_mi.pose.film.body_prior` and
:mod:`gva_mi.pose.film.smoothness`. Errors have heavy tails: each is a square whose weight follows
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

from gva_mi.body import so3
from gva_mi.body.pose import HANDS, JOINTS, LEFT_HAND, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress
from gva_mi.core.errors import InputError
from gva_mi.core.options import Within
from gva_mi.core.same_bits import sqrt
from gva_mi.core.threads import one_torch_thread
from gva_mi.data.importers.lens import in_pixels, pinhole_K
from gva_mi.data.landmarks import Landmarks
from gva_mi.pose.film.arm_depths import with_arm_depths
from gva_mi.pose.film.body_prior import FOCAL, HEIGHT, HEIGHT_KNOWN, BodyPrior, SharedPrior
from gva_mi.pose.film.film_evidence import film_evidence
from gva_mi.pose.film.film_problem import FilmProblem
from gva_mi.pose.film.film_start import first_place, first_root
from gva_mi.pose.film.film_state import FilmState, Free
from gva_mi.pose.film.landmark_noise import LandmarkNoise, frames_alike
from gva_mi.pose.film.normal_equations import NormalEquations
from gva_mi.pose.film.rig import LandmarkRig
from gva_mi.pose.film.smoothness import Smoothness
from gva_mi.pose.film.vertical_lines import Vertical
from gva_mi.pose.stature import PERSON_HEIGHTS, Stature
from gva_mi.splat import Camera

CAMERA_HEIGHTS = Within(0.05, 20, unit="metres")  # above the floor
LENS = 26.0  # mm of 35 mm film, of an unknown camera: main cameras of phones have 24 to 28
FOCAL_KNOWN = 1e-4  # of its logarithm
START, BODY, HAND = 8, 30, 15  # steps, at most
_PALM = ("hand_wrist", "thumb_cmc", "index_mcp", "middle_mcp", "ring_mcp", "pinky_mcp")
_FACE = ("jaw", "left_eye_smplhf", "right_eye_smplhf")
_BODY = [k for k, name in enumerate(JOINTS[: LEFT_HAND.start]) if name not in _FACE]


@dataclass(frozen=True)
class SolvedFilm:
    """Stage 1 of a film of T frames, in a world with y up and the floor at y = 0."""

    pose: Pose
    shape: Shape
    camera: Camera
    names: tuple[str, ...]  # P landmarks that were used
    offsets: Tensor  # (P, 3) their constant offsets on the resting body, metres
    spread: Tensor  # (T, 55) posterior standard deviation of each joint's rotation, radians
    lost: list[int]  # frames without the person
    hands_seen: tuple[float, float]  # share of the frames, left and right
    tilt: float  # degrees that the camera looks down


@dataclass(frozen=True)
class KnownOfFilm:
    """What is known of a film beforehand; None: unknown.

    Attributes:
        height: of the person, metres; without it a prior of people's heights, which leaves size and
            distance uncertain by 5 %.
        focal: focal length, pixels; without it a prior around the main cameras of phones.
        centre: principal point, pixels; without it the middle of the picture.
        lines: the direction up by lines of the room, for that focal length or for :data:`LENS`.
        camera_height: of the lens above the floor, metres.
    """

    height: float | None = None
    focal: float | None = None
    centre: tuple[float, float] | None = None
    lines: Vertical | None = None
    camera_height: float | None = None

    def __post_init__(self) -> None:
        for name, range_ in (("height", PERSON_HEIGHTS), ("camera_height", CAMERA_HEIGHTS)):
            if getattr(self, name) is not None:
                range_.require("a film", name, getattr(self, name))
        if self.focal is not None and not (np.isfinite(self.focal) and self.focal > 0):
            raise InputError(f"a film: focal must be positive, got {self.focal}")

    def K(self, size: tuple[int, int]) -> np.ndarray:
        """Return the camera to start from, for pictures of a width and height, pixels."""
        centre = self.centre or (size[0] / 2, size[1] / 2)
        return pinhole_K(self.focal or in_pixels(LENS, size), centre)


def solve_film(
    landmarks: Landmarks,
    body: BodyModel,
    size: tuple[int, int],
    fps: float,
    known: KnownOfFilm = KnownOfFilm(),  # noqa: B008 (frozen)
    progress: Progress | None = None,
) -> SolvedFilm:
    """Find poses, shape and camera of one person before a camera that stands still.

    Args:
        landmarks: T frames.
        body: SMPL-X's or the built-in one.
        size: width and height of the pictures, pixels.
        fps: frames a second.
        known: beforehand.
        progress: called as ``progress(done, total)``.

    Raises:
        InputError: no frame has a person, or a number is out of range.
    """
    if not (np.isfinite(fps) and fps > 0):
        raise InputError(f"solve_film(): fps must be positive, got {fps}")
    report = progress or (lambda done, total, **figures: None)
    with one_torch_thread(), torch.no_grad():
        film = _Film.of(landmarks, body, size, fps, known)
        state = film.first()
        state, _ = film.body_problem(state, starting=True).minimised(state, START)
        report(1, 4)
        problem = film.body_problem(state)
        state, _ = problem.minimised(state, BODY)
        problem = film.with_arm_depths(problem, state)
        state, equations = problem.minimised(state, BODY)
        spread = _per_joint(equations, _BODY)
        report(2, 4)
        for k, (side, fingers) in enumerate(HANDS.items()):
            joints = list(range(len(JOINTS)))[fingers]
            state, equations = film.hand_problem(state, side).minimised(state, HAND)
            spread = spread + _per_joint(equations, joints)
            report(3 + k, 4)
        return film.result(state, spread)


@dataclass(frozen=True)
class _Film:
    """A film to solve."""

    landmarks: Landmarks
    body: BodyModel
    size: tuple[int, int]
    dt: float
    known: KnownOfFilm
    rig: LandmarkRig
    noise: LandmarkNoise
    K: np.ndarray

    @staticmethod
    def of(
        landmarks: Landmarks,
        body: BodyModel,
        size: tuple[int, int],
        fps: float,
        known: KnownOfFilm,
    ) -> _Film:
        rig = LandmarkRig.of(body, sorted(landmarks.names))
        at, names = landmarks.indices(rig.names), ("pixels", "confidence", "spread", "metric")
        arrays = {name: getattr(landmarks, name)[:, at] for name in names}
        landmarks = Landmarks(rig.names, **arrays)
        noise = LandmarkNoise.of(landmarks, rig.names)
        return _Film(landmarks, body, size, 1 / fps, known, rig, noise, known.K(size))

    def first(self) -> FilmState:
        """Return the first guess: relaxed joints, the body at its place."""
        free = Free(_BODY)
        prior = BodyPrior.of(free, self.body.j_template)
        shape = self.mean_shape()
        count = len(self.landmarks)
        rotations = prior.relaxed.expand(count, -1, -1).clone()
        rotations[:, 0] = so3.to_rotvec(first_root(self.landmarks))
        scale = self.rig.scale(self.landmarks, shape.betas)
        place = first_place(self.landmarks, self.K, scale)
        zero = lambda *shape: torch.zeros(shape, dtype=torch.float64)
        up = zero(2)
        floor = place[:, 1].median() + 0.5 * (self.known.height or HEIGHT[0])
        habits = zero(len(prior.anatomy.freedoms))
        offsets = zero(len(self.rig.names), 3)
        return FilmState(rotations, place, shape.betas.double(), zero(), up, floor, offsets, habits)

    def mean_shape(self) -> Shape:
        """Return the mean person of the given height."""
        mean = Shape(self.body.v_template.new_zeros(self.body.num_betas))
        return Stature.of(self.body).nearest(mean, self.known.height or HEIGHT[0])

    def body_problem(self, state: FilmState, starting: bool = False) -> FilmProblem:
        """Return the problem of body and palms; the starting one has no shared unknowns."""
        names = self.rig.names
        which = [p for p, name in enumerate(names) if "_hand_" not in name or name.endswith(_PALM)]
        if starting:
            problem = self._problem(Free(_BODY), which, state)
            return replace(problem, evidence=replace(problem.evidence, starting=True))
        prior = BodyPrior.of(Free(_BODY), self.body.j_template)
        offsets = list(range(len(which)))
        free = Free(_BODY, len(state.betas), True, offsets, prior.habits(_BODY))
        return self._problem(free, which, state)

    def with_arm_depths(self, problem: FilmProblem, state: FilmState) -> FilmProblem:
        """Return the problem with the arms' depths as all frames see them, around a solution."""
        which = list(problem.which)
        names = [self.rig.names[p] for p in which]
        state = replace(state, offsets=state.offsets[which])
        return replace(problem, evidence=with_arm_depths(problem.evidence, names, state, self.dt))

    def hand_problem(self, state: FilmState, side: str) -> FilmProblem:
        """Return the problem of one hand's fingers."""
        joints = list(range(len(JOINTS)))[HANDS[side]]
        which = [p for p, name in enumerate(self.rig.names) if f"{side}_hand_" in name]
        prior = BodyPrior.of(Free(joints), self.body.j_template)
        of_fingers = [k for k, p in enumerate(which) if not self.rig.names[p].endswith(_PALM)]
        free = Free(joints, 0, False, of_fingers, prior.habits(joints))
        return self._problem(free, which, state, side)

    def _problem(
        self, free: Free, which: Sequence[int], state: FilmState, hand: str | None = None
    ) -> FilmProblem:
        rig = LandmarkRig.of(self.body, [self.rig.names[p] for p in which])
        noise = LandmarkNoise.of(self.landmarks, rig.names)
        at = self.landmarks.indices(rig.names)
        pixels = torch.from_numpy(self.landmarks.pixels[:, at])
        scale = self.rig.scale(self.landmarks, state.betas.float())
        metric = scale * torch.from_numpy(self.landmarks.metric[:, at])
        memory, K = frames_alike(self.landmarks, self.dt, hand), torch.from_numpy(self.K)
        evidence = film_evidence(self.body, rig, free, (pixels, metric, noise), K, memory)
        prior = BodyPrior.of(free, self.body.j_template, memory)
        always = torch.tensor([f.always for f in prior.anatomy.freedoms]).double()
        known = self.known
        shared = SharedPrior(
            free,
            rig.names,
            rig.loose,
            torch.deg2rad(always),
            self.mean_shape().betas.double(),
            Stature.of(self.body),
            (known.height, HEIGHT_KNOWN) if known.height else HEIGHT,
            FOCAL_KNOWN if known.focal else FOCAL,
            known.lines,
            known.camera_height,
        )
        return FilmProblem(free, which, evidence, prior, shared, Smoothness(free, self.dt))

    def result(self, state: FilmState, spread: Tensor) -> SolvedFilm:
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
        found = self.noise.pixels.isfinite()
        some = lambda text: [p for p, name in enumerate(self.rig.names) if text in name]
        of_body = [p for p in some("") if p not in some("_hand_")]
        lost = (~found[:, of_body].any(1)).nonzero()[:, 0].tolist()
        seen = tuple(float(found[:, some(f"{s}_hand_")].any(1).float().mean()) for s in HANDS)
        tilt = -math.degrees(math.asin(float(up[2])))
        found = self.rig.names, state.offsets.float(), spread.float(), lost, seen, tilt
        return SolvedFilm(pose, shape, camera, *found)


def _per_joint(equations: NormalEquations, joints: Sequence[int]) -> Tensor:
    """Return the spread (T, 55) of joints, the last columns of a frame; zero elsewhere."""
    each = equations.spread().unflatten(1, (-1, 3))[:, -len(joints) :]
    whole = each.new_zeros(len(each), len(JOINTS))
    whole[:, list(joints)] = sqrt(each.square().mean(2))
    return whole
