"""What is known of poses and people before any picture, as weighted squares.

1. Every joint is near a relaxed pose, arms down and fingers half bent (:data:`POSE_SIGMA`).
2. Hinges bend about one axis and within a range (:mod:`gva_mi.prior.anatomy`). The constant
   offsets of their angles are unknowns of the video, ``angle_offsets``.
3. Constant offsets of landmarks are near zero, and nearly mirrored between left and right. Betas
   are near the mean person of the given height, or of an average height, and keep this height.
4. Up is where the lines of the room say (:mod:`gva_mi.stage1.vertical_lines`). Without lines, a
   phone is held nearly level, and looks down a little. The camera's height above the floor may be
   known; together with the person's size it shows which way is up, too.

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
from gva_mi.body.so3 import turns_between
from gva_mi.prior.anatomy import LIMIT_SIGMA_DEGREES, Anatomy
from gva_mi.prior.body_height import Stature
from gva_mi.prior.error_model import STUDENT_DOF
from gva_mi.stage1.normal_equations import NormalEquations
from gva_mi.stage1.unknowns import Stage1State, Unknowns
from gva_mi.stage1.vertical_lines import Vertical

# Standard deviations about the relaxed pose, radians, of all axes or of x, y and z of the T-pose;
# None: 1 radian, of joints that this prior leaves out. Chosen: wrists hardly twist, which forearms
# do; hips bend more than they spread or turn.
WRIST_SIGMA, HIP_SIGMA = (0.15, 0.4, 0.4), (0.7, 0.3, 0.3)
POSE_SIGMA = {
    "pelvis": None, "spine1": 0.2, "spine2": 0.2, "spine3": 0.2, "neck": 0.3, "head": 0.3,
    "collar": 0.15, "shoulder": 1.2, "elbow": 1.2, "wrist": WRIST_SIGMA, "hip": HIP_SIGMA,
    "knee": 1.0, "ankle": 0.35, "foot": 0.2, "jaw": None, "eye_smplhf": None,
}  # fmt: skip
FINGER_SIGMA = 0.5  # the same of a finger's joints, radians; chosen by eye
RELAXED_ARM = {"shoulder": 0.9, "elbow": 0.2}  # radians down, and bent; chosen by eye
RELAXED_FINGER = {1: 0.25, 2: 0.4, 3: 0.27}  # bend of a finger's joints, radians; by eye
BETA_SIGMA = 0.35  # of betas; chosen below 1: landmarks know lengths, not girths
AVERAGE_HEIGHT = 1.70  # metres, of a person of unknown height; chosen: an average adult
HEIGHT_SIGMA = 0.005  # metres, of the fitted height about the given or average one; it hardly moves
# Metres, of the camera's height above the floor: about a given height, chosen by eye, and
# about 0 without: nothing is known.
KNOWN_CAMERA_HEIGHT_SIGMA, UNKNOWN_CAMERA_HEIGHT_SIGMA = 0.02, 10.0
ASYMMETRY = 0.3  # standard deviation of the difference of left and right offsets, relative; by eye
# Of the logarithm of an unknown focal length. Chosen: ln(28 mm / 24 mm), the range of phones.
UNKNOWN_FOCAL_SIGMA = 0.15
# Without lines: standard deviations of the direction up aside and in depth, and its mean in depth,
# radians; chosen by eye.
UP_SIGMA, LOOKS_DOWN = (0.04, 0.15), 0.07


class MotionSigma(NamedTuple):
    """Standard deviations of a motion, a and v of :class:`Smoothness`."""

    acceleration: float  # a, m/s² or rad/s²
    speed: float  # v, m/s or rad/s


# Chosen: the trunk is heavy and turns evenly; limbs are light.
PELVIS_MOTION = MotionSigma(8.0, 1.5)  # of the pelvis position, m/s² and m/s
TRUNK_MOTION = MotionSigma(8.0, 10.0)  # of the trunk's joint rotations, rad/s² and rad/s
LIMB_MOTION = MotionSigma(120.0, 10.0)  # of the limbs' joint rotations, rad/s² and rad/s
FINGER_MOTION = MotionSigma(40.0, 6.0)  # of the fingers' joint rotations, rad/s² and rad/s
_TRUNK = [k for k, n in enumerate(JOINTS) if n.startswith(("pelvis", "spine", "neck", "head"))]


class PriorRows(NamedTuple):
    """One term in n frames as weighted residuals, ``E = Σ w r² / 2``."""

    residuals: Tensor  # (n, N) r
    weights: Tensor  # (n, N) w
    by_frame: Tensor  # (N, F) ∂r / ∂(unknowns of a frame), the same in all frames
    by_shared: Tensor  # (N, S) ∂r / ∂(shared unknowns)


def relaxed_pose(anatomy: Anatomy) -> Tensor:
    """Return rotations (55, 3) of relaxed joints, radians: arms down and fingers half bent."""
    relaxed = torch.zeros(len(JOINTS), 3, dtype=torch.float64)
    for sign, side in ((-1, "left"), (1, "right")):
        relaxed[JOINTS.index(f"{side}_shoulder"), 2] = sign * RELAXED_ARM["shoulder"]
        relaxed[JOINTS.index(f"{side}_elbow"), 1] = sign * RELAXED_ARM["elbow"]
    for bend in anatomy.bends:
        (joint,) = bend.any(1).nonzero()[:, 0].tolist()
        if joint >= LEFT_HAND.start:
            relaxed[joint] = RELAXED_FINGER[int(JOINTS[joint][-1])] * bend[joint]
    return relaxed


def angles_of(anatomy: Anatomy, joints: Sequence[int]) -> list[int]:
    """Return the angles of an anatomy to which only the given joints contribute."""
    others = [j for j in range(len(JOINTS)) if j not in joints or j == 0]
    return [q for q, row in enumerate(anatomy.A) if not bool(row[others].any())]


@dataclass(frozen=True)
class BodyPrior:
    """Terms (1) and (2) for the unknowns of one problem."""

    unknowns: Unknowns
    anatomy: Anatomy
    relaxed: Tensor  # (55, 3) radians
    precision: Tensor  # (55, 3) 1 / σ² of (1)
    correlated: Tensor  # (T,) ``m``, the frames that count as one

    @staticmethod
    def of(unknowns: Unknowns, anatomy: Anatomy, correlated: Tensor) -> BodyPrior:
        """Collect the terms; ``correlated`` is ``m`` (T,)."""
        spread = torch.full((len(JOINTS), 3), FINGER_SIGMA, dtype=torch.float64)
        for k, name in enumerate(JOINTS[: LEFT_HAND.start]):
            part = name.removeprefix("left_").removeprefix("right_")
            spread[k] = torch.tensor(POSE_SIGMA[part] or 1.0)
        return BodyPrior(unknowns, anatomy, relaxed_pose(anatomy), spread**-2, correlated)

    def energy(self, state: Stage1State) -> Tensor:
        """Return (1) and (2), nats."""
        return sum((rows.weights * rows.residuals.square()).sum() / 2 for rows in self.rows(state))

    def rows(self, state: Stage1State) -> Iterator[PriorRows]:
        """Yield (1), then (2): angles that should be zero, and bends beyond their limits."""
        joints = [j for j in self.unknowns.joints if j]
        first = self.unknowns.per_frame - 3 * len(joints)
        shared = self.unknowns.shared
        correlated = self.correlated[:, None].expand(len(state.pelvis_position), 1)
        r = state.rotations[:, joints]
        zeros = lambda N: state.pelvis_position.new_zeros(N, self.unknowns.per_frame)
        eye = zeros(3 * len(joints))
        eye[:, first:] = torch.eye(3 * len(joints))
        weights = self.precision[joints].flatten() / correlated
        apart = (r - self.relaxed[joints]).flatten(1)
        yield PriorRows(apart, weights, eye, eye.new_zeros(len(eye), shared))

        angles = angles_of(self.anatomy, self.unknowns.joints)
        A = self.anatomy.A[angles][:, joints].double().flatten(1)
        by_frame, by_shared = zeros(len(A)), state.pelvis_position.new_zeros(len(A), shared)
        by_frame[:, first:] = A
        if self.unknowns.angle_offsets:
            by_shared[:, self.unknowns.angle_offsets_column :] = -torch.eye(len(A))
        varying = torch.tensor([self.anatomy.spreads[q].varying for q in angles]).double()
        weights = torch.deg2rad(varying) ** -2 / correlated
        apart = r.flatten(1) @ A.T - state.angle_offsets[angles]
        yield PriorRows(apart, weights, by_frame, by_shared)

        mine = self.anatomy.bends[:, joints].flatten(1).any(1)
        bends = self.anatomy.bends[mine][:, joints].double().flatten(1)
        low, high = self.anatomy.limits[mine].double().unbind(1)
        bend = r.flatten(1) @ bends.T
        past = (bend - high).clamp_min(0) - (low - bend).clamp_min(0)
        by_frame = zeros(len(bends))
        by_frame[:, first:] = bends
        weights = (past != 0) / (correlated * math.radians(LIMIT_SIGMA_DEGREES) ** 2)
        yield PriorRows(past, weights, by_frame, by_frame.new_zeros(len(bends), shared))


@dataclass(frozen=True)
class SharedPrior:
    """Terms (3) and (4), of the unknowns that all frames share.

    Attributes:
        unknowns: of the problem.
        names: of the P landmarks.
        offset_spread: (P,) standard deviation of their offsets, metres.
        angle_sigma: (Q,) standard deviation of angle_offsets, radians.
        betas: (B,) the mean person of the given height.
        stature: of the body.
        height: of the person, metres.
        focal_sigma: standard deviation of the focal length's logarithm.
        lines: the direction up, as the room's lines show it with the first focal length.
        camera_height: above the floor, metres; None: unknown.
    """

    unknowns: Unknowns
    names: Sequence[str]
    offset_spread: Tensor
    angle_sigma: Tensor
    betas: Tensor
    stature: Stature
    height: float
    focal_sigma: float
    lines: Vertical | None
    camera_height: float | None

    def parts(self, state: Stage1State) -> tuple[Tensor, Tensor]:
        """Return residuals and standard deviations (S,) of the shared unknowns.

        Offsets of a left and a right landmark are replaced by their mean and their difference.
        """
        found = [(state.betas - self.betas)[: self.unknowns.betas]]
        spread = [torch.full_like(found[0], BETA_SIGMA)]
        if self.unknowns.camera:
            up, deviations = self._up(state)
            height, known = self.camera_height, KNOWN_CAMERA_HEIGHT_SIGMA
            if height is None:
                height, known = 0.0, UNKNOWN_CAMERA_HEIGHT_SIGMA
            found += [state.log_focal_scale[None], state.up - up, state.floor[None] - height]
            spread += [state.up.new_tensor([self.focal_sigma, *deviations, known])]
        offsets, angles = list(self.unknowns.offsets), list(self.unknowns.angle_offsets)
        found += [self._sides() @ state.offsets[offsets].flatten(), state.angle_offsets[angles]]
        likely = self.offset_spread[offsets].double()
        at = {self.names[p]: k for k, p in enumerate(offsets)}
        for name, k in at.items():
            if "right" in name and _left(name) in at:
                likely[k] = ASYMMETRY * likely[k]
        spread += [likely.repeat_interleave(3), self.angle_sigma[angles]]
        return torch.cat(found), torch.cat(spread)

    def _up(self, state: Stage1State) -> tuple[Tensor, Sequence[float]]:
        """Return the likely direction up (2,), and its standard deviations.

        If the camera looks down, vertical lines converge in the picture, and less for a longer
        lens.
        """
        if self.lines is None:
            return state.up.new_tensor([0.0, -LOOKS_DOWN]), UP_SIGMA
        up = torch.from_numpy(self.lines.up)
        return torch.stack([up[0], up[1] * state.log_focal_scale.exp()]), self.lines.spread

    def _sides(self) -> Tensor:
        """Return the rotation (3 n, 3 n) of offsets to sums and differences of left and right.

        The right offset is mirrored first; landmarks of neither side stay.
        """
        names = [self.names[p] for p in self.unknowns.offsets]
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

    def height_excess(self, state: Stage1State) -> tuple[Tensor, Tensor, float]:
        """Return the excess height, its derivatives with respect to betas (B,), and its sigma."""
        slope = self.stature.slope.double()[: self.unknowns.betas]
        height = self.stature.mean + slope @ state.betas[: len(slope)]
        return height - self.height, slope, HEIGHT_SIGMA

    def energy(self, state: Stage1State) -> Tensor:
        """Return (3) and (4), nats."""
        apart, spread = self.parts(state)
        total = (apart / spread).square().sum() / 2
        if self.unknowns.betas:
            taller, _, sigma = self.height_excess(state)
            total = total + (taller / sigma).square() / 2
        return total

    def add(self, state: Stage1State, equations: NormalEquations) -> None:
        """Add (3) and (4) to the equations."""
        if not self.unknowns.shared:
            return
        apart, spread = self.parts(state)
        turn = torch.eye(len(apart), dtype=apart.dtype)
        offsets = slice(self.unknowns.offsets_column, self.unknowns.angle_offsets_column)
        turn[offsets, offsets] = self._sides()
        if self.unknowns.camera and self.lines is not None:
            focal = self.unknowns.camera_column
            turn[focal + 2, focal] = -self._up(state)[0][1]
        equations.shared += turn.T @ (turn * spread[:, None] ** -2)
        equations.shared_pull -= turn.T @ (apart / spread**2)
        if self.unknowns.betas:
            taller, slope, sigma = self.height_excess(state)
            betas = slice(0, len(slope))
            equations.shared[betas, betas] += slope[:, None] * slope / sigma**2
            equations.shared_pull[betas] -= taller * slope / sigma**2


def _left(name: str) -> str:
    return name.replace("right", "left")


@dataclass(frozen=True)
class Smoothness:
    """Penalise accelerations and speeds of joints and of the person.

    The values ``x_t`` of a joint, ``dt`` seconds apart, cost

    1. ``E = Σ_t (ν + 3)/2 log(1 + |x_t+1 - 2 x_t + x_t-1|² / ν (a dt²)²)``
       ``  + Σ_t |x_t+1 - x_t|² / 2 (v dt)²``

    ``a`` and ``v`` are standard deviations of acceleration and speed (:class:`MotionSigma`). So
    steps of a video of half the frame rate may change four times as much. For the root
    ``x_t+1 - x_t`` is the rotation from one frame to the next.
    """

    unknowns: Unknowns
    dt: float  # seconds

    def energy(self, state: Stage1State) -> Tensor:
        """Return eq. 1, nats."""
        total = state.pelvis_position.new_zeros(())
        for steps, (a, v) in self._groups(state):
            bends = steps.diff(dim=0).square().sum(-1) / (a * self.dt**2) ** 2
            total = total + (STUDENT_DOF + 3) / 2 * torch.log1p(bends / STUDENT_DOF).sum()
            total = total + (steps / (v * self.dt)).square().sum() / 2
        return total

    def add(self, state: Stage1State, equations: NormalEquations) -> None:
        """Add eq. 1, as weighted squares, to the equations."""
        for k, (steps, (a, v)) in enumerate(self._groups(state)):
            columns = slice(3 * k, 3 * k + 3)
            equations.add_steps(steps, 1 / (v * self.dt) ** 2, columns)
            if len(steps) < 2:
                continue
            bends, scale = steps.diff(dim=0), (a * self.dt**2) ** 2
            square = bends.square().sum(-1, keepdim=True) / scale
            w = (STUDENT_DOF + 3) / (STUDENT_DOF + square) / scale
            diagonal = equations.frames.diagonal(dim1=1, dim2=2)[:, columns]
            for start, part in ((0, 1.0), (1, -2.0), (2, 1.0)):
                some = slice(start, start + len(bends))
                diagonal[some] += part**2 * w
                equations.pull[some, columns] -= part * w * bends
            equations.next[:-2, columns] -= 2 * w
            equations.next[1:-1, columns] -= 2 * w
            equations.second[:-2, columns] += w

    def _groups(self, state: Stage1State) -> Iterator[tuple[Tensor, MotionSigma]]:
        """Yield the steps (T - 1, 3) of every three columns, and their standard deviations."""
        if self.unknowns.travels:
            yield state.pelvis_position.diff(dim=0), PELVIS_MOTION
        for joint in self.unknowns.joints:
            r = state.rotations[:, joint]
            steps = r.diff(dim=0) if joint else turns_between(r[:-1], r[1:])
            if joint >= LEFT_HAND.start:
                yield steps, FINGER_MOTION
            else:
                yield steps, TRUNK_MOTION if joint in _TRUNK else LIMB_MOTION
