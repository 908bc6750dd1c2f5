"""What is known of poses and people without a picture, as weighted squares.

1. Every joint is near a relaxed pose, arms down and fingers half bent, within ``SPREAD``.
2. Hinges bend about one axis and within a range (:mod:`gva_mi.prior.anatomy`). The constant
   offsets of their angles are unknowns of the video, ``angle_offsets``.
3. Landmarks' constant offsets are near zero, and nearly those of the other side, mirrored. Betas
   are near the mean person's of the given height, or of an average one, which they keep.
4. Up is where the lines of the room say (:mod:`gva_mi.stage1.upright`); without any, a
   phone is held nearly level, and looks down a little. The height of the camera above the floor may
   be known; with the size of the person it shows as well which way is up.

``m`` frames count as one in (1) and (2), as in the evidence.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from gva_mi.body.pose import JOINTS, LEFT_HAND
from gva_mi.prior.anatomy import PAST_LIMIT, Anatomy
from gva_mi.prior.error_model import FREEDOM
from gva_mi.prior.stage1_poses import turns_between
from gva_mi.prior.stature import Stature
from gva_mi.stage1.normal_equations import Free, NormalEquations, Stage1State
from gva_mi.stage1.upright import Vertical

# Standard deviations about the relaxed pose, radians, of all axes or of x, y and z of the T-pose:
# wrists hardly twist, which is what forearms do; hips bend more than they spread or turn.
WRIST, HIP = (0.15, 0.4, 0.4), (0.7, 0.3, 0.3)
SPREAD = {
    "pelvis": None, "spine1": 0.2, "spine2": 0.2, "spine3": 0.2, "neck": 0.3, "head": 0.3,
    "collar": 0.15, "shoulder": 1.2, "elbow": 1.2, "wrist": WRIST, "hip": HIP, "knee": 1.0,
    "ankle": 0.35, "foot": 0.2, "jaw": None, "eye_smplhf": None,
}  # fmt: skip
FINGER = 0.5
RELAXED = {"shoulder": 0.9, "elbow": 0.2}  # radians down, and bent
CURL = {1: 0.25, 2: 0.4, 3: 0.27}  # of a finger's joints, radians
BETA = 0.35  # standard deviation of betas: landmarks know lengths, not girths
HEIGHT = 1.70  # of a person of unknown height, metres
HEIGHT_SPREAD = 0.005  # standard deviation of the body's height about that, or about a given one
CAMERA_KNOWN, CAMERA_ANYWHERE = 0.02, 10.0  # of the camera's height, metres
UNLIKE = 0.3  # of the offset of a landmark, the share in which left and right differ
FOCAL = 0.15  # of its logarithm
UP, LOOKS_DOWN = (0.04, 0.15), 0.07  # of the upward direction aside and in depth; radians
PLACE_MOTION = (8.0, 1.5)  # a, v of the person: m/s², m/s
TRUNK_MOTION = (8.0, 10.0)  # rad/s², rad/s: what is heavy turns evenly
LIMB_MOTION = (120.0, 10.0)
FINGER_MOTION = (40.0, 6.0)
_TRUNK = [
    k for k, name in enumerate(JOINTS) if name.startswith(("pelvis", "spine", "neck", "head"))
]


class Rows(NamedTuple):
    """Weighted residuals, ``E = Σ w r² / 2`` around the current unknowns."""

    residuals: Tensor  # (n, N)
    weights: Tensor  # (n, N)
    by_frame: Tensor  # (N, F), their derivatives
    by_shared: Tensor  # (N, S)


def relaxed_pose(anatomy: Anatomy) -> Tensor:
    """Return rotations (55, 3) of relaxed joints, radians: arms down and fingers half bent."""
    relaxed = torch.zeros(len(JOINTS), 3, dtype=torch.float64)
    for sign, side in ((-1, "left"), (1, "right")):
        relaxed[JOINTS.index(f"{side}_shoulder"), 2] = sign * RELAXED["shoulder"]
        relaxed[JOINTS.index(f"{side}_elbow"), 1] = sign * RELAXED["elbow"]
    for bend in anatomy.bends:
        (joint,) = bend.any(1).nonzero()[:, 0].tolist()
        if joint >= LEFT_HAND.start:
            relaxed[joint] = CURL[int(JOINTS[joint][-1])] * bend[joint]
    return relaxed


def angles_of(anatomy: Anatomy, joints: Sequence[int]) -> list[int]:
    """Return the angles of an anatomy that only some joints form."""
    others = [j for j in range(len(JOINTS)) if j not in joints or j == 0]
    return [q for q, row in enumerate(anatomy.A) if not bool(row[others].any())]


@dataclass(frozen=True)
class BodyPrior:
    """The terms above, for some unknowns."""

    free: Free
    anatomy: Anatomy
    relaxed: Tensor  # (55, 3) radians
    precision: Tensor  # (55, 3) of (1)
    correlated: Tensor  # (T,) ``m``, the frames that count as one

    @staticmethod
    def of(free: Free, anatomy: Anatomy, correlated: Tensor) -> BodyPrior:
        """Collect the terms; ``correlated`` is m (T,)."""
        spread = torch.full((len(JOINTS), 3), FINGER, dtype=torch.float64)
        for k, name in enumerate(JOINTS[: LEFT_HAND.start]):
            part = name.removeprefix("left_").removeprefix("right_")
            spread[k] = torch.tensor(SPREAD[part] or 1.0)
        return BodyPrior(free, anatomy, relaxed_pose(anatomy), spread**-2, correlated)

    def energy(self, state: Stage1State) -> Tensor:
        """Return (1) and (2), nats."""
        return sum((rows.weights * rows.residuals.square()).sum() / 2 for rows in self.rows(state))

    def rows(self, state: Stage1State) -> Iterator[Rows]:
        """Yield (1) and (2)."""
        joints = [j for j in self.free.joints if j]
        first = self.free.per_frame - 3 * len(joints)
        shared = self.free.shared
        count = len(state.place)
        correlated = self.correlated[:, None].expand(count, 1)
        r = state.rotations[:, joints]
        some = lambda N: state.place.new_zeros(N, self.free.per_frame)
        own = some(3 * len(joints))
        own[:, first:] = torch.eye(3 * len(joints))
        weights = self.precision[joints].flatten() / correlated
        yield Rows(
            (r - self.relaxed[joints]).flatten(1), weights, own, own.new_zeros(len(own), shared)
        )

        angles = angles_of(self.anatomy, self.free.joints)
        A = self.anatomy.A[angles][:, joints].double().flatten(1)
        by_frame, by_shared = some(len(A)), state.place.new_zeros(len(A), shared)
        by_frame[:, first:] = A
        if self.free.angle_offsets:
            by_shared[:, self.free.first_of_angle_offsets :] = -torch.eye(len(A))
        varying = torch.tensor([self.anatomy.freedoms[q].varying for q in angles]).double()
        weights = torch.deg2rad(varying) ** -2 / correlated
        yield Rows(r.flatten(1) @ A.T - state.angle_offsets[angles], weights, by_frame, by_shared)

        mine = self.anatomy.bends[:, joints].flatten(1).any(1)
        bends = self.anatomy.bends[mine][:, joints].double().flatten(1)
        low, high = self.anatomy.limits[mine].double().unbind(1)
        bend = r.flatten(1) @ bends.T
        past = (bend - high).clamp_min(0) - (low - bend).clamp_min(0)
        by_frame = some(len(bends))
        by_frame[:, first:] = bends
        weights = (past != 0) / (correlated * math.radians(PAST_LIMIT) ** 2)
        yield Rows(past, weights, by_frame, by_frame.new_zeros(len(bends), shared))


@dataclass(frozen=True)
class SharedPrior:
    """Term (3) and (4): diagonal, but for the height and for the offsets of both sides.

    Attributes:
        free: the unknowns.
        names: P landmarks.
        offset_spread: (P,) standard deviation of their offsets, metres.
        always: (Q,) of angle_offsets, radians.
        betas: (B,) the mean person of the given height.
        stature: of the body.
        height: of the person, metres.
        focal: standard deviation of the focal length's logarithm.
        lines: the direction up, as the room's lines show it with the first focal length.
        camera_height: above the floor, metres; None: unknown.
    """

    free: Free
    names: Sequence[str]
    offset_spread: Tensor
    always: Tensor
    betas: Tensor
    stature: Stature
    height: float
    focal: float
    lines: Vertical | None
    camera_height: float | None

    def parts(self, state: Stage1State) -> tuple[Tensor, Tensor]:
        """Return residuals and standard deviations (S,) of the shared unknowns.

        Offsets are replaced by what both sides have in common, and by how they differ.
        """
        found = [(state.betas - self.betas)[: self.free.betas]]
        spread = [torch.full_like(found[0], BETA)]
        if self.free.camera:
            up, deviations = self._up(state)
            above = state.floor[None] - (self.camera_height or 0.0)
            known = CAMERA_ANYWHERE if self.camera_height is None else CAMERA_KNOWN
            found += [state.focal[None], state.up - up, above]
            spread += [state.up.new_tensor([self.focal, *deviations, known])]
        offsets, angles = list(self.free.offsets), list(self.free.angle_offsets)
        found += [self._sides() @ state.offsets[offsets].flatten(), state.angle_offsets[angles]]
        likely = self.offset_spread[offsets].double()
        at = {self.names[p]: k for k, p in enumerate(offsets)}
        for name, k in at.items():
            if "right" in name and _left(name) in at:
                likely[k] = UNLIKE * likely[k]
        spread += [likely.repeat_interleave(3), self.always[angles]]
        return torch.cat(found), torch.cat(spread)

    def _up(self, state: Stage1State) -> tuple[Tensor, Sequence[float]]:
        """Return the likely direction up (2,), and its standard deviations.

        Lines of a picture taken from above converge, which a longer lens shows less.
        """
        if self.lines is None:
            return state.up.new_tensor([0.0, -LOOKS_DOWN]), UP
        up = torch.from_numpy(self.lines.up)
        return torch.stack([up[0], up[1] * state.focal.exp()]), self.lines.spread

    def _sides(self) -> Tensor:
        """Return the rotation of offsets (3 n, 3 n): of a left and a right one, sum and difference.

        The right one is mirrored first; landmarks of neither side stay.
        """
        names = [self.names[p] for p in self.free.offsets]
        turn = torch.eye(3 * len(names), dtype=torch.float64)
        mirror = torch.diag(torch.tensor([-1.0, 1, 1], dtype=torch.float64)) / 2**0.5
        for k, name in enumerate(names):
            if "right" in name and _left(name) in names:
                left = names.index(_left(name))
                one, other = slice(3 * left, 3 * left + 3), slice(3 * k, 3 * k + 3)
                turn[one, one] /= 2**0.5
                turn[one, other] = mirror
                turn[other, one] = turn[one, one]
                turn[other, other] = -mirror
        return turn

    def taller(self, state: Stage1State) -> tuple[Tensor, Tensor, float]:
        """Return how much too tall the person is, its slope (B,), and its standard deviation."""
        slope = self.stature.slope.double()[: self.free.betas]
        height = self.stature.mean + slope @ state.betas[: len(slope)]
        return height - self.height, slope, HEIGHT_SPREAD

    def energy(self, state: Stage1State) -> Tensor:
        """Return (3) and (4), nats."""
        apart, spread = self.parts(state)
        total = (apart / spread).square().sum() / 2
        if self.free.betas:
            taller, _, sigma = self.taller(state)
            total = total + (taller / sigma).square() / 2
        return total

    def add(self, state: Stage1State, equations: NormalEquations) -> None:
        """Add (3) and (4) to the equations."""
        if not self.free.shared:
            return
        apart, spread = self.parts(state)
        turn = torch.eye(len(apart), dtype=apart.dtype)
        some = slice(self.free.first_of_offsets, self.free.first_of_angle_offsets)
        turn[some, some] = self._sides()
        if self.free.camera and self.lines is not None:
            focal = self.free.first_of_camera
            turn[focal + 2, focal] = -self._up(state)[0][1]
        equations.shared += turn.T @ (turn * spread[:, None] ** -2)
        equations.shared_pull -= turn.T @ (apart / spread**2)
        if self.free.betas:
            taller, slope, sigma = self.taller(state)
            some = slice(0, len(slope))
            equations.shared[some, some] += slope[:, None] * slope / sigma**2
            equations.shared_pull[some] -= taller * slope / sigma**2


def _left(name: str) -> str:
    return name.replace("right", "left")


@dataclass(frozen=True)
class Smoothness:
    """Joints and the person accelerate little, and do not turn too fast; ``dt`` in seconds.

    Of values ``x_t`` of a joint, ``dt`` seconds apart,

    1. ``E = Σ_t (ν + 3)/2 log(1 + |x_t+1 - 2 x_t + x_t-1|² / ν (a dt²)²)``
       ``  + Σ_t |x_t+1 - x_t|² / 2 (v dt)²``

    ``a`` and ``v`` are standard deviations of acceleration and speed. So a video of half the frame
    rate may change four times as much from step to step. For the root ``x_t+1 - x_t`` is the
    rotation from one frame to the next.
    """

    free: Free
    dt: float

    def energy(self, state: Stage1State) -> Tensor:
        """Return eq. 1, nats."""
        total = state.place.new_zeros(())
        for steps, (a, v) in self._groups(state):
            bends = steps.diff(dim=0).square().sum(-1) / (a * self.dt**2) ** 2
            total = total + (FREEDOM + 3) / 2 * torch.log1p(bends / FREEDOM).sum()
            total = total + (steps / (v * self.dt)).square().sum() / 2
        return total

    def add(self, state: Stage1State, equations: NormalEquations) -> None:
        """Add eq. 1, as weighted squares, to the equations."""
        for k, (steps, (a, v)) in enumerate(self._groups(state)):
            columns = slice(3 * k, 3 * k + 3)
            equations.add_steps(steps, 1 / (v * self.dt) ** 2, columns)
            if len(steps) > 1:
                self._add_bends(steps, a, equations, columns)

    def _groups(self, state: Stage1State) -> Iterator[tuple[Tensor, tuple[float, float]]]:
        """Yield the steps (T - 1, 3) of every three columns, and their a and v."""
        if self.free.travels:
            yield state.place.diff(dim=0), PLACE_MOTION
        for joint in self.free.joints:
            r = state.rotations[:, joint]
            steps = r.diff(dim=0) if joint else turns_between(r[:-1], r[1:])
            if joint >= LEFT_HAND.start:
                yield steps, FINGER_MOTION
            else:
                yield steps, TRUNK_MOTION if joint in _TRUNK else LIMB_MOTION

    def _add_bends(
        self, steps: Tensor, a: float, equations: NormalEquations, columns: slice
    ) -> None:
        bends, scale = steps.diff(dim=0), (a * self.dt**2) ** 2
        square = bends.square().sum(-1, keepdim=True) / scale
        w = (FREEDOM + 3) / (FREEDOM + square) / scale
        diagonal = equations.frames.diagonal(dim1=1, dim2=2)[:, columns]
        for start, part in ((0, 1.0), (1, -2.0), (2, 1.0)):
            some = slice(start, start + len(bends))
            diagonal[some] += part**2 * w
            equations.pull[some, columns] -= part * w * bends
        equations.next[:-2, columns] -= 2 * w
        equations.next[1:-1, columns] -= 2 * w
        equations.second[:-2, columns] += w
