"""Stage-1 poses as an estimator on single frames gives them: level 1 is usual, 0 is exact.

Errors of rotations grow toward hands and feet and persist over some frames; depth is known worst.
How far depends on :class:`PoseNoise`, which also says what else goes wrong: what is the same in
every frame (:mod:`gva_mi.data.synthetic.noise.camera_bias`), and what comes in some frames alone
(:mod:`gva_mi.data.synthetic.noise.outliers`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from gva_mi.body.pose import JOINTS, LEFT_HAND, RIGHT_HAND, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.data.synthetic.noise.camera_bias import Lean, leaning, matrices, placed
from gva_mi.data.synthetic.noise.outliers import (
    LEG,
    SIDES,
    Outliers,
    jumps,
    lose_hands,
    spoil_frames,
    swap_legs,
)
from gva_mi.data.synthetic.noise.processes import bumps, curve
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
    "legs": LEG,
}
LIMBS: Sequence[Sequence[str]] = tuple(  # a burst comes over one of them
    tuple(f"{side}_{name}" for name in PARTS[part]) for part in ("arms", "legs") for side in SIDES
)
BURST_EVERY, BURST_LENGTH = 25.0, 2.5  # frames between bursts, on average; half length of one


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
    outliers: Outliers = Outliers()


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
    lose_hands(rotations, noise.outliers, level, rng)
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

    swap_legs(rotations, noise.outliers, level, rng)
    spoil_frames(rotations, sizes, noise.outliers, level, rng)
    transl += jumps(frames, noise.outliers, level, rng) @ R_camera_world
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


def _growth(body: BodyModel, before: Shape, after: Shape) -> float:
    """How many times as large a person is, by the distances of joints from the pelvis."""
    small, large = (body.rest(shape).joints[:22].double() for shape in (before, after))
    return float((large - large[0]).norm() / (small - small[0]).norm())


def believed_camera(camera: Camera, noise: PoseNoise, level: float) -> Camera:
    """The camera whose focal length the estimator takes for the true one."""
    factor = 1 + level * noise.focal
    return replace(camera, fx=camera.fx * factor, fy=camera.fy * factor)
