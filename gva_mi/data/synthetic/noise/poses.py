"""Stage-1 poses as an estimator on single frames gives them: level 1 is usual, 0 is exact.

Errors of rotations grow toward hands and feet and persist over some frames; depth is known worst.
How far depends on :class:`PoseNoise`, which also says what else goes wrong: joints that lean toward
the camera in every frame, a person taken for a larger one farther away, another focal length, legs
that are swapped, hands that are lost, jumps, and frames of which nothing is right.

All that is random is drawn in the same order whatever the parameters are, so that a parameter
changes its own error alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from gva_mi.body.pose import JOINTS, LEFT_HAND, RIGHT_HAND, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.data.synthetic.noise.camera_bias import Lean, leaning, matrices, placed
from gva_mi.data.synthetic.noise.processes import bumps, curve, runs
from gva_mi.splat import Camera

# Root mean square rotation errors in radians, before the doubling at the side. They grow along the
# limbs; what leans the whole trunk is known best.
ROTATION: Mapping[str, float] = {
    "pelvis": 0.045, "spine1": 0.02, "spine2": 0.02, "spine3": 0.02, "neck": 0.05, "head": 0.07,
    "collar": 0.03, "shoulder": 0.055, "elbow": 0.095, "wrist": 0.16,
    "hip": 0.06, "knee": 0.085, "ankle": 0.15, "foot": 0.15,
}  # fmt: skip
FACE, FINGER = 0.02, 0.16  # jaw and eyes; every joint of the fingers
PARTS: Mapping[str, Sequence[str]] = {  # of JointFactors; jaw and eyes belong to the head
    "trunk": ("pelvis", "spine1", "spine2", "spine3"),
    "arms": ("collar", "shoulder", "elbow", "wrist"),
    "legs": ("hip", "knee", "ankle", "foot"),
}
SIDES = ("left", "right")
LIMBS: Sequence[Sequence[str]] = tuple(  # a burst comes over one of them
    tuple(f"{side}_{name}" for name in PARTS[part]) for part in ("arms", "legs") for side in SIDES
)
BURST_EVERY, BURST_LENGTH = 25.0, 2.5  # frames between bursts, on average; half length of one
LOST_FRAMES = 5.0  # length of a drop-out of a hand, on average
MEAN_FINGER = 0.3  # rad, how far the fingers of the mean hand curl
SWAPPED_FRAMES, JUMP_FRAMES = 4.0, 4.0  # in a row, on average
OUTLIER = 5.0  # factor on the sizes above in a frame of which nothing is right


@dataclass(frozen=True)
class JointFactors:
    """Factors on the sizes of rotation errors."""

    trunk: float = 1.0
    head: float = 1.0  # with neck and face
    arms: float = 1.0  # from the collar to the wrist
    legs: float = 1.0
    fingers: float = 1.0


@dataclass(frozen=True)
class PoseNoise:
    """How wrong the stage-1 poses of a video are."""

    sizes: JointFactors = JointFactors()
    memory: float = 5.0  # frames over which the slow part of an error persists
    white: float = 0.0  # share of the variance that is independent from frame to frame, 0 to 1
    calm: float = 0.66  # factor on errors of limbs, at rest
    burst: float = 3.1  # the same at the height of a burst, at most
    sideways: float = 1.0  # how much larger errors are where the person stands sideways
    depth: float = 0.028  # m, translation along the line of sight
    aside: float = 0.008  # m, across it
    betas: float = 0.25  # standard deviations
    depth_follows: bool = False  # who is taken for larger is put farther away: the picture stays
    expression: float = 0.3  # standard deviations, of every coefficient that moves at all
    lean: Lean = Lean()
    focal: float = 0.0  # the focal length is taken for this share longer; depth follows
    lost: float = 0.08  # share of frames, in runs, in which a hand is lost
    swapped: float = 0.0  # share of frames, in runs, in which left and right leg are swapped
    jumps: float = 0.0  # share of frames, in runs, in which the person sits somewhere else
    jump: float = 0.08  # m, how far, root mean square
    outliers: float = 0.0  # share of single frames of which nothing is right


def noisy_poses(
    body: BodyModel,
    pose: Pose,
    shape: Shape,
    camera: Camera,
    noise: PoseNoise,
    level: float,
    rng: np.random.Generator,
) -> tuple[Pose, Shape]:
    """Stage-1 poses of a video.

    Args:
        body: the poses are for it.
        pose: the truth, T frames.
        shape: the truth.
        camera: the true view; it decides what is sideways and what is depth.
        noise: what goes wrong, and how far.
        level: factor on all of it; 0 returns the truth itself.
        rng: for all errors.
    """
    if level == 0:
        return pose, shape
    frames = len(pose)
    strength = level * (1 + noise.sideways * sideways(pose, camera) ** 2)[:, None]
    sizes = _sizes(noise, frames, rng)
    rotations = pose.rotations.double().numpy().copy()
    for joint, size in enumerate(sizes):
        error = curve(rng, frames, noise.memory, noise.white)
        rotations[:, joint] += strength * size[:, None] * error
    _lose_hands(rotations, noise, level, rng)
    aside = curve(rng, frames, noise.memory, noise.white)
    aside = aside * np.array([noise.aside, noise.aside, noise.depth]) * np.sqrt(3)
    R_camera_world = camera.T_camera_world[:3, :3]
    transl = pose.transl.double().numpy() + (strength * aside) @ R_camera_world
    error = torch.from_numpy(rng.normal(size=len(shape.betas))).float()
    betas = shape.betas + level * noise.betas * error
    expression = pose.expression.double().numpy().copy()
    for k in np.flatnonzero(expression.any(0)):
        error = curve(rng, frames, noise.memory, noise.white)
        expression[:, k] += level * noise.expression * error[:, 0] * np.sqrt(3)

    _swap_legs(rotations, runs(rng, frames, _share(level, noise.swapped), SWAPPED_FRAMES))
    transl += _jumps(noise, level, frames, rng) @ R_camera_world
    wrong = rng.random(frames) < _share(level, noise.outliers)
    error = rng.normal(size=rotations.shape) / np.sqrt(3)
    rotations[wrong] += (level * OUTLIER * sizes.T[..., None] * error)[wrong]
    rotations = leaning(rotations, camera, noise.lean.times(level))
    grown = _growth(body, shape, Shape(betas)) if noise.depth_follows else 1.0
    joints = (body.rest(shape).joints[0], body.rest(Shape(betas)).joints[0])
    transl = placed(transl, camera, *joints, grown, level * noise.focal)
    tensor = lambda x: torch.from_numpy(x).to(pose.transl.dtype)
    return Pose(tensor(rotations), tensor(transl), tensor(expression)), Shape(betas)


def sideways(pose: Pose, camera: Camera) -> np.ndarray:
    """How far a person stands sideways (T,): 0 seen from front or back, 1 from the side."""
    facing = matrices(pose.rotations[:, 0].double().numpy())[:, :, 2]
    return np.abs(facing @ camera.T_camera_world[0, :3])


def mean_hand(side: str) -> np.ndarray:
    """Rotations (15, 3) of a relaxed hand."""
    sign = 1.0 if side == "left" else -1.0
    rotations = np.zeros((15, 3))
    rotations[:12, 2] = -sign * MEAN_FINGER  # all but the thumb
    return rotations


def _share(level: float, share: float) -> float:
    return min(level * share, 0.9)


def _sizes(noise: PoseNoise, frames: int, rng: np.random.Generator) -> np.ndarray:
    """Root mean square error of each joint's rotation in each frame, radians, (55, T)."""
    part = {name: part for part, names in PARTS.items() for name in names}
    sizes = []
    for name in (joint.split("_")[-1] for joint in JOINTS):
        factor = getattr(noise.sizes, part.get(name, "head"))
        sizes.append(ROTATION.get(name, FACE) * factor)
    sizes = np.array(sizes)
    sizes[LEFT_HAND] = sizes[RIGHT_HAND] = FINGER * noise.sizes.fingers
    sizes = sizes[:, None] * np.full(frames, 1.0)
    for limb in LIMBS:
        burst = bumps(rng, frames, noise.calm, noise.burst, BURST_EVERY, BURST_LENGTH)
        for name in limb:
            sizes[JOINTS.index(name)] *= burst
    return sizes


def _lose_hands(
    rotations: np.ndarray, noise: PoseNoise, level: float, rng: np.random.Generator
) -> None:
    """In some frames, put the mean hand on a straight wrist, as an estimator does."""
    for side, hand in (("left", LEFT_HAND), ("right", RIGHT_HAND)):
        lost = runs(rng, len(rotations), level * noise.lost, LOST_FRAMES)[:, None, None]
        lost = min(level, 1.0) * lost
        rotations[:, hand] += lost * (mean_hand(side) - rotations[:, hand])
        wrist = rotations[:, [JOINTS.index(f"{side}_wrist")]]
        rotations[:, [JOINTS.index(f"{side}_wrist")]] = (1 - lost) * wrist


def _swap_legs(rotations: np.ndarray, where: np.ndarray) -> None:
    """In some frames (T,) bool, give each leg the mirrored rotations of the other."""
    left, right = ([JOINTS.index(f"{side}_{name}") for name in PARTS["legs"]] for side in SIDES)
    mirrored = rotations[np.ix_(where, right + left)] * (1, -1, -1)  # in the plane x = 0
    rotations[np.ix_(where, left + right)] = mirrored


def _jumps(noise: PoseNoise, level: float, frames: int, rng: np.random.Generator) -> np.ndarray:
    """Displacements (T, 3) in camera axes, metres: constant over each of some runs of frames."""
    away = runs(rng, frames, _share(level, noise.jumps), JUMP_FRAMES)
    run = np.cumsum(np.diff(away, prepend=False) & away)  # its number, where there is one
    where = rng.normal(size=(frames + 1, 3)) * (0.6, 0.6, 1.5) / np.sqrt(3)
    return noise.jump * where[run] * away[:, None]


def _growth(body: BodyModel, before: Shape, after: Shape) -> float:
    """How many times as large a person is, by the distances of joints from the pelvis."""
    small, large = (body.rest(shape).joints[:22].double() for shape in (before, after))
    return float((large - large[0]).norm() / (small - small[0]).norm())


def believed_camera(camera: Camera, noise: PoseNoise, level: float) -> Camera:
    """The camera whose focal length the estimator takes for the true one."""
    factor = 1 + level * noise.focal
    return replace(camera, fx=camera.fx * factor, fy=camera.fy * factor)
