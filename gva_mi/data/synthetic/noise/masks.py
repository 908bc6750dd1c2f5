"""Masks as a segmenter gives them: level 1 is usual, 0 is exact.

The boundary wobbles by a pixel or two, with some notches. A segmenter may also draw every boundary
too far out or in, lose the feet for some frames, or take a thing for a part of the person: a bag,
which stays at the same place of the body in all frames. Lengths in pixels are those of a picture
512 pixels wide, and scale with its width.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gva_mi.body.kinematics import joint_transforms
from gva_mi.body.pose import JOINTS, PARENTS, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.data.synthetic.noise.outliers import SIDES
from gva_mi.data.synthetic.noise.processes import field, runs
from gva_mi.splat import Camera

FEET_FRAMES = 6.0  # frames in a row in which a foot is lost, on average
FOOT = 0.30  # m, how far a foot reaches from its ankle
FLESH = 0.09  # m, from the joint of a hip out to the side


@dataclass(frozen=True)
class MaskNoise:
    """How wrong the masks of a video are."""

    wobble: float = 1.1  # px at 512, error of the boundary
    wobble_length: float = 14.0  # px at 512, over which it varies
    notches: int = 4  # dents and bumps on a mask's boundary
    notch_radius: float = 4.0  # px at 512
    grown: float = 0.0  # px at 512 by which the boundary lies too far out; below 0: too far in
    lost_feet: float = 0.0  # share of the frames, in runs, in which a foot is cut off
    bag: float = 0.0  # m, radius of what hangs at a hip and is taken for the person; 0: nothing


@dataclass(frozen=True)
class HalfDisc:
    """The part of a disc that lies on one side of its middle, in pixels."""

    centre: tuple[float, float]
    toward: tuple[float, float]  # unit vector to the side that is meant
    radius: float


@dataclass(frozen=True)
class Mistaken:
    """What is taken for something else in one frame."""

    lost: tuple[HalfDisc, ...] = ()  # feet, from the ankle on
    bag: tuple[float, float, float] | None = None  # px, centre and radius


def mistaken(
    body: BodyModel,
    pose: Pose,
    shape: Shape,
    camera: Camera,
    noise: MaskNoise,
    level: float,
    rng: np.random.Generator,
) -> list[Mistaken]:
    """What is taken for something else in each of T frames.

    Args:
        body: whose feet and hips they are.
        pose: T frames.
        shape: the person's.
        camera: that sees it.
        noise: what is lost, and what is added.
        level: factor on both.
        rng: in which frames feet are lost; on which side the bag hangs.
    """
    frames, rest = len(pose), body.rest(shape).joints
    T_world_rest = joint_transforms(pose.rotations, rest, PARENTS, pose.transl).double().numpy()
    R, t = T_world_rest[..., :3, :3], T_world_rest[..., :3, 3]
    joints = np.einsum("tjab,jb->tja", R, rest.double().numpy()) + t
    lost = {
        side: runs(rng, frames, min(level * noise.lost_feet, 0.9), FEET_FRAMES) for side in SIDES
    }
    bags = _bags(joints, R[:, 0], camera, level * noise.bag, SIDES[rng.integers(2)])
    found = []
    for k in range(frames):
        feet = [side for side in SIDES if lost[side][k]]
        found.append(Mistaken(tuple(_foot(joints[k], camera, s) for s in feet), bags[k]))
    return found


def noisy_mask(
    mask: np.ndarray,
    noise: MaskNoise,
    level: float,
    rng: np.random.Generator,
    seen: Mistaken = Mistaken(),  # noqa: B008 (frozen)
) -> np.ndarray:
    """A mask (H, W) in [0, 1] with a boundary that is off by a pixel or two at level 1."""
    if level == 0:
        return mask
    from scipy.ndimage import distance_transform_edt, gaussian_filter

    pixel = mask.shape[1] / 512
    inside = _mistaken_for(mask > 0.5, seen)
    if not inside.any():
        return np.zeros_like(mask)
    distance = distance_transform_edt(inside) - distance_transform_edt(~inside)
    distance += np.where(inside, -0.5, 0.5)  # signed, zero on the boundary, positive inside
    distance = gaussian_filter(distance, 0.6)  # over the steps from pixel to pixel
    length = max(noise.wobble_length * pixel, 0.7)
    wobble = level * max(noise.wobble * pixel, 0.25) * field(rng, mask.shape, length)
    edge = np.argwhere(np.abs(distance) < 1)
    for centre in edge[rng.integers(len(edge), size=noise.notches)] if len(edge) else ():
        radius = level * noise.notch_radius * pixel * rng.uniform(0.4, 1.3)
        rows, columns = np.ogrid[: mask.shape[0], : mask.shape[1]]
        away = np.hypot(rows - centre[0], columns - centre[1])
        notch = np.maximum(radius - away, 0)
        wobble += rng.choice([-1, -1, 1]) * notch
    grown = level * noise.grown * pixel
    return np.clip(distance + wobble + grown + 0.5, 0, 1).astype(np.float32)


def _mistaken_for(inside: np.ndarray, seen: Mistaken) -> np.ndarray:
    """A hard mask with what is added, without what is lost."""
    if not seen.lost and seen.bag is None:
        return inside
    y, x = np.mgrid[: inside.shape[0], : inside.shape[1]] + 0.5
    inside = inside.copy()
    if seen.bag is not None:
        u, v, radius = seen.bag
        inside |= np.hypot(x - u, y - v) < radius
    for foot in seen.lost:
        dx, dy = x - foot.centre[0], y - foot.centre[1]
        beyond = dx * foot.toward[0] + dy * foot.toward[1] > 0
        inside &= ~(beyond & (np.hypot(dx, dy) < foot.radius))
    return inside


def _foot(joints: np.ndarray, camera: Camera, side: str) -> HalfDisc:
    """What lies beyond the ankle, seen along the shin."""
    knee, ankle = (joints[JOINTS.index(f"{side}_{name}")] for name in ("knee", "ankle"))
    start, end = camera.project(knee), camera.project(ankle)
    toward = (end - start) / max(float(np.linalg.norm(end - start)), 1e-6)
    return HalfDisc(tuple(end.tolist()), tuple(toward.tolist()), FOOT * _scale(camera, ankle))


def _bags(
    joints: np.ndarray, R_pelvis: np.ndarray, camera: Camera, radius: float, side: str
) -> list[tuple[float, float, float] | None]:
    """Centre and radius, in pixels, of a ball that hangs beside a hip."""
    if radius == 0:
        return [None] * len(joints)
    outward = 1.0 if side == "left" else -1.0
    beside = np.array([outward * (FLESH + radius / 2), -0.06, -0.02])
    centres = joints[:, JOINTS.index(f"{side}_hip")] + R_pelvis @ beside
    pixels = camera.project(centres)
    return [
        (*map(float, pixel), radius * _scale(camera, centre))
        for pixel, centre in zip(pixels, centres, strict=True)
    ]


def _scale(camera: Camera, point: np.ndarray) -> float:
    """Pixels per metre where a point lies."""
    depth = camera.T_camera_world[2, :3] @ point + camera.T_camera_world[2, 3]
    return float(camera.fx / depth)
