"""Error model of stage-1 poses, as of an estimator on single frames: level 1 is usual, 0 is exact.

Rotation errors grow toward hands and feet and persist over some frames; depth has the largest
translation error. :class:`PoseErrors` holds the sizes of all errors, including constant ones
(:mod:`gva_mi.synthetic.error_models.camera_bias`) and gross ones in some frames
(:mod:`gva_mi.synthetic.error_models.outliers`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from gva_mi.body.pose import JOINTS, LEFT_HAND, RIGHT_HAND, SIDES, Pose, Shape
from gva_mi.body.rotations import to_matrices
from gva_mi.body.smplx import BodyModel
from gva_mi.splat import Camera
from gva_mi.synthetic.error_models.camera_bias import CameraTilt, placed, tilted
from gva_mi.synthetic.error_models.outliers import (
    LEG,
    Outliers,
    jumps,
    lose_hands,
    spoil_frames,
    swap_legs,
)
from gva_mi.synthetic.error_models.processes import bumps, curve

# Root mean square rotation errors in radians, seen from the front. They grow along the limbs.
ROTATION: Mapping[str, float] = {
    "pelvis": 0.045, "spine1": 0.02, "spine2": 0.02, "spine3": 0.02, "neck": 0.05, "head": 0.07,
    "collar": 0.03, "shoulder": 0.055, "elbow": 0.095, "wrist": 0.16,
    "hip": 0.06, "knee": 0.085, "ankle": 0.15, "foot": 0.15,
}  # fmt: skip
FACE, FINGER = 0.02, 0.16  # jaw and eyes; every joint of the fingers
PARTS: Mapping[str, Sequence[str]] = {  # of JointFactors; all other joints are the head's
    "trunk": ("pelvis", "spine1", "spine2", "spine3"),
    "arms": ("collar", "shoulder", "elbow", "wrist"),
    "legs": LEG,
}
LIMBS: Sequence[Sequence[str]] = tuple(  # a burst affects one of them
    tuple(f"{side}_{name}" for name in PARTS[part]) for part in ("arms", "legs") for side in SIDES
)
BURST_EVERY, BURST_LENGTH = 25.0, 2.5  # mean frames between bursts; half length of one


@dataclass(frozen=True)
class JointFactors:
    """Factors on the sizes of rotation errors."""

    trunk: float = 1.0
    head: float = 1.0  # with neck and face
    arms: float = 1.0  # from the collar to the wrist
    legs: float = 1.0
    fingers: float = 1.0


@dataclass(frozen=True)
class PoseErrors:
    """Sizes of the errors of a video's stage-1 poses."""

    sizes: JointFactors = JointFactors()
    memory: float = 5.0  # frames, persistence of the slow part of an error
    white: float = 0.0  # fraction of the variance that is independent from frame to frame
    calm: float = 0.66  # factor on errors of limbs between bursts
    burst: float = 3.1  # largest factor within a burst
    sideways: float = 1.0  # relative growth of errors seen from the side
    depth: float = 0.028  # m, translation along the line of sight
    aside: float = 0.008  # m, across it
    betas: float = 0.25  # standard deviations
    depth_follows: bool = False  # a person estimated larger is placed farther: the picture stays
    expression: float = 0.3  # standard deviations, of all nonzero coefficients
    lean: CameraTilt = CameraTilt()
    focal: float = 0.0  # relative error of the focal length; depth follows
    outliers: Outliers = Outliers()


def noisy_poses(
    body: BodyModel,
    pose: Pose,
    shape: Shape,
    camera: Camera,
    noise: PoseErrors,
    level: float,
    rng: np.random.Generator,
) -> tuple[Pose, Shape]:
    """Draw stage-1 poses of a video from the ground truth.

    The true ``camera`` defines sideways and depth. ``level`` is a factor on all errors; 0 returns
    the ground truth itself.
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
    rotations = tilted(rotations, camera, noise.lean, level)
    grown = _growth(body, shape, Shape(betas)) if noise.depth_follows else 1.0
    joints = (body.rest(shape).joints[0], body.rest(Shape(betas)).joints[0])
    transl = placed(transl, camera, *joints, grown, level * noise.focal)
    tensor = lambda x: torch.from_numpy(x).to(pose.transl.dtype)
    return Pose(tensor(rotations), tensor(transl), tensor(expression)), Shape(betas)


def sideways(pose: Pose, camera: Camera) -> np.ndarray:
    """Return (T,): 0 if a person is seen from front or back, 1 from the side."""
    facing = to_matrices(pose.rotations[:, 0].numpy())[:, :, 2]
    return np.abs(facing @ camera.T_camera_world[0, :3])


def _sizes(noise: PoseErrors, frames: int, rng: np.random.Generator) -> np.ndarray:
    """Draw the root mean square error of each joint's rotation per frame, radians, (55, T)."""
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
    """Return the ratio of body sizes, by the distances of joints from the pelvis."""
    small, large = (body.rest(shape).joints[:22].double() for shape in (before, after))
    return float((large - large[0]).norm() / (small - small[0]).norm())


def estimated_camera(camera: Camera, noise: PoseErrors, level: float) -> Camera:
    """Return the camera with the focal length that the estimator assumes."""
    factor = 1 + level * noise.focal
    return replace(camera, fx=camera.fx * factor, fy=camera.fy * factor)
