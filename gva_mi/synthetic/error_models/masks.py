"""Error model of masks: level 1 is usual, 0 is exact.

The boundary wobbles by a pixel or two and has some notches. A segmenter may also draw every
boundary too far out or in, lose the feet for some frames, or include a bag that stays at the same
place of the body. Lengths in pixels refer to pictures 512 pixels wide and scale with the width.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gva_mi.body.kinematics import joint_places, joint_transforms
from gva_mi.body.pose import JOINTS, PARENTS, SIDES, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.splat import Camera
from gva_mi.synthetic.error_models.processes import field, runs

FEET_FRAMES = 6.0  # mean number of consecutive frames without a foot
FOOT = 0.30  # m, length of a foot from the ankle
FLESH = 0.09  # m, from the hip joint to the side of the body


@dataclass(frozen=True)
class MaskErrors:
    """Sizes of the errors of a video's masks."""

    wobble: float = 1.1  # px at 512, error of the boundary
    wobble_length: float = 14.0  # px at 512, scale of its variation
    notches: int = 4  # dents and bumps on a mask's boundary
    notch_radius: float = 4.0  # px at 512
    grown: float = 0.0  # px at 512 that the boundary lies too far out; negative: too far in
    lost_feet: float = 0.0  # fraction of the frames, in runs, without a foot
    bag: float = 0.0  # m, radius of a bag at a hip that counts as person; 0: none


Pixel = tuple[float, float]
HalfDisc = tuple[Pixel, Pixel, float]  # centre, unit vector to that half, radius in pixels


@dataclass(frozen=True)
class Confusion:
    """What a segmenter confuses in one frame."""

    lost: tuple[HalfDisc, ...] = ()  # feet, beyond the ankle
    bag: tuple[float, float, float] | None = None  # px, centre and radius


def confusions(
    body: BodyModel,
    pose: Pose,
    shape: Shape,
    camera: Camera,
    noise: MaskErrors,
    level: float,
    rng: np.random.Generator,
) -> list[Confusion]:
    """Draw in which of T frames feet are lost and on which side a bag hangs.

    ``level`` is a factor on both.
    """
    frames, rest = len(pose), body.rest(shape).joints
    T_world_rest = joint_transforms(pose.rotations, rest, PARENTS, pose.transl).double()
    R, joints = T_world_rest[..., :3, :3].numpy(), joint_places(T_world_rest, rest.double()).numpy()
    lost = {
        side: runs(rng, frames, min(level * noise.lost_feet, 0.9), FEET_FRAMES) for side in SIDES
    }
    bags = _bags(joints, R[:, 0], camera, level * noise.bag, SIDES[rng.integers(2)])
    found = []
    for k in range(frames):
        feet = [side for side in SIDES if lost[side][k]]
        found.append(Confusion(tuple(_foot(joints[k], camera, s) for s in feet), bags[k]))
    return found


def noisy_mask(
    mask: np.ndarray,
    noise: MaskErrors,
    level: float,
    rng: np.random.Generator,
    confusion: Confusion = Confusion(),  # noqa: B008 (frozen)
) -> np.ndarray:
    """Degrade a mask (H, W) in [0, 1]; the boundary is off by a pixel or two at level 1."""
    if level == 0:
        return mask
    from scipy.ndimage import distance_transform_edt, gaussian_filter

    pixel = mask.shape[1] / 512
    inside = _confused(mask > 0.5, confusion)
    if not inside.any():
        return np.zeros_like(mask)
    distance = distance_transform_edt(inside) - distance_transform_edt(~inside)
    distance += np.where(inside, -0.5, 0.5)  # signed, zero on the boundary, positive inside
    distance = gaussian_filter(distance, 0.6)  # over the steps between pixels
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


def _confused(inside: np.ndarray, confusion: Confusion) -> np.ndarray:
    """Add the bag to a binary mask and cut off lost feet."""
    if not confusion.lost and confusion.bag is None:
        return inside
    y, x = np.mgrid[: inside.shape[0], : inside.shape[1]] + 0.5
    inside = inside.copy()
    if confusion.bag is not None:
        u, v, radius = confusion.bag
        inside |= np.hypot(x - u, y - v) < radius
    for centre, toward, radius in confusion.lost:
        dx, dy = x - centre[0], y - centre[1]
        inside &= ~((dx * toward[0] + dy * toward[1] > 0) & (np.hypot(dx, dy) < radius))
    return inside


def _foot(joints: np.ndarray, camera: Camera, side: str) -> HalfDisc:
    """Return what lies beyond the ankle in the direction of the shin."""
    knee, ankle = (joints[JOINTS.index(f"{side}_{name}")] for name in ("knee", "ankle"))
    start, end = camera.project(knee), camera.project(ankle)
    toward = (end - start) / max(float(np.linalg.norm(end - start)), 1e-6)
    return tuple(end.tolist()), tuple(toward.tolist()), FOOT * _scale(camera, ankle)


def _bags(
    joints: np.ndarray, R_pelvis: np.ndarray, camera: Camera, radius: float, side: str
) -> list[tuple[float, float, float] | None]:
    """Return centre and radius, in pixels, of a ball beside a hip."""
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
    """Return pixels per metre at the depth of a point."""
    depth = camera.T_camera_world[2, :3] @ point + camera.T_camera_world[2, 3]
    return float(camera.fx / depth)
