"""Error models of masks and normals.

**Masks.** The boundary wobbles by a pixel or two and has some notches. A segmenter may also draw
every boundary too far out or in, lose the feet for some frames, or include a bag that stays at the
same place of the body.

**Normals** are blurred and turned by an error that varies slowly over the picture. They may also be
flattened, turned the same way in every frame, given in another convention, or missing in frames.

Lengths in pixels refer to pictures 512 pixels wide and scale with the width.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.random import Generator

from gva_mi.body.kinematics import joint_places, joint_transforms
from gva_mi.body.pose import JOINTS, PARENTS, SIDES, Pose, Shape
from gva_mi.body.rotations import to_matrices
from gva_mi.body.smplx import BodyModel
from gva_mi.splat import Camera
from gva_mi.subject.normals import Convention
from gva_mi.synthetic.errors.poses import runs

# Chosen: the size of an adult; feet that are lost stay lost for some frames.
LOST_FOOT_FRAMES = 6.0  # frames, mean length of a run without a foot
FOOT_LENGTH = 0.30  # m, from the ankle
HIP_TO_SIDE = 0.09  # m, from the hip joint to the side of the body


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


@dataclass(frozen=True)
class NormalErrors:
    """Sizes of the errors of a video's normals."""

    blur: float = 2.2  # px at 512, standard deviation
    tilt: float = 0.14  # rad, error that varies over the picture
    tilt_length: float = 50.0  # px at 512, scale of its variation
    flat: float = 0.0  # relative shortening across the line of sight, before normalisation
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)  # rad, constant, camera axes
    convention: Convention = "perspective"  # of the files
    missing: float = 0.0  # fraction of the frames without normals


Pixel = tuple[float, float]


class Disc(NamedTuple):
    """A disc in a picture, pixels."""

    u: float  # of its centre
    v: float
    radius: float


class HalfDisc(NamedTuple):
    """Half a disc in a picture, pixels."""

    centre: Pixel
    toward: Pixel  # unit vector to the half
    radius: float


@dataclass(frozen=True)
class Confusion:
    """What a segmenter confuses in one frame."""

    lost: tuple[HalfDisc, ...] = ()  # feet, beyond the ankle
    bag: Disc | None = None


def confusions(
    body: BodyModel, pose: Pose, shape: Shape, camera: Camera, noise: MaskErrors, rng: Generator
) -> list[Confusion]:
    """Draw in which of T frames feet are lost and on which side a bag hangs."""
    frames, rest = len(pose), body.rest(shape).joints
    T_world_rest = joint_transforms(pose.rotations, rest, PARENTS, pose.transl).double()
    R, joints = T_world_rest[..., :3, :3].numpy(), joint_places(T_world_rest, rest.double()).numpy()
    lost = {side: runs(rng, frames, noise.lost_feet, LOST_FOOT_FRAMES) for side in SIDES}
    bags = _bags(joints, R[:, 0], camera, noise.bag, SIDES[rng.integers(2)])
    return [
        Confusion(tuple(_foot(joints[k], camera, s) for s in SIDES if lost[s][k]), bags[k])
        for k in range(frames)
    ]


def noisy_mask(
    mask: np.ndarray,
    noise: MaskErrors,
    rng: Generator,
    confusion: Confusion = Confusion(),  # noqa: B008 (frozen)
) -> np.ndarray:
    """Degrade a mask (H, W) in [0, 1]."""
    from scipy.ndimage import distance_transform_edt, gaussian_filter

    pixel = mask.shape[1] / 512
    inside = _confused(mask > 0.5, confusion)
    if not inside.any():
        return np.zeros_like(mask)
    distance = distance_transform_edt(inside) - distance_transform_edt(~inside)
    distance += np.where(inside, -0.5, 0.5)  # signed, zero on the boundary, positive inside
    distance = gaussian_filter(distance, 0.6)  # over the steps between pixels
    length = max(noise.wobble_length * pixel, 0.7)
    wobble = max(noise.wobble * pixel, 0.25) * _field(rng, mask.shape, length)
    edge = np.argwhere(np.abs(distance) < 1)
    for centre in edge[rng.integers(len(edge), size=noise.notches)] if len(edge) else ():
        radius = noise.notch_radius * pixel * rng.uniform(0.4, 1.3)
        rows, columns = np.ogrid[: mask.shape[0], : mask.shape[1]]
        notch = np.maximum(radius - np.hypot(rows - centre[0], columns - centre[1]), 0)
        wobble += rng.choice([-1, -1, 1]) * notch
    grown = noise.grown * pixel
    return np.clip(distance + wobble + grown + 0.5, 0, 1).astype(np.float32)


def noisy_normals(
    normals: np.ndarray, mask: np.ndarray, noise: NormalErrors, rng: Generator
) -> np.ndarray:
    """Degrade normals (H, W, 3) in camera space inside a mask (H, W)."""
    from scipy.ndimage import distance_transform_edt, gaussian_filter

    pixel = normals.shape[1] / 512
    reach = max(noise.blur * pixel, 0.3)
    blurred = np.stack([gaussian_filter(normals[..., k], reach) for k in range(3)], axis=-1)
    length = np.linalg.norm(blurred, axis=-1)
    # Where the mask extends past the surface, use the nearest normal.
    near = distance_transform_edt(length < 1e-3, return_distances=False, return_indices=True)
    blurred = blurred[*near] / np.maximum(length[*near], 1e-9)[..., None]
    axes = [_field(rng, mask.shape, noise.tilt_length * pixel) for _ in range(3)]
    turned = blurred + noise.tilt / np.sqrt(2) * np.cross(np.stack(axes, -1), blurred)
    if noise.flat:
        turned = turned * np.array([1 - noise.flat] * 2 + [1])
    if any(noise.turn):
        turned = turned @ to_matrices(np.array(noise.turn)).T
    turned[..., 2] = np.minimum(turned[..., 2], 0)  # visible surfaces face the camera
    turned /= np.maximum(np.linalg.norm(turned, axis=-1, keepdims=True), 1e-9)
    return (turned * (mask > 0.5)[..., None]).astype(np.float32)


def _field(rng: Generator, shape: tuple[int, int], length: float) -> np.ndarray:
    """Draw a smooth random image of unit variance that varies over ``length`` pixels."""
    from scipy.ndimage import zoom

    nodes = [int(np.ceil(n / length)) + 3 for n in shape]  # a lattice to interpolate
    scale = max((n + 2 * length) / k for n, k in zip(shape, nodes, strict=True))
    fine = zoom(rng.normal(size=nodes), scale, order=3)
    top, left = ((f - n) // 2 for f, n in zip(fine.shape, shape, strict=True))
    image = fine[top : top + shape[0], left : left + shape[1]]
    return image / image.std()


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
    radius = FOOT_LENGTH * _scale(camera, ankle)
    return HalfDisc(tuple(end.tolist()), tuple(toward.tolist()), radius)


def _bags(
    joints: np.ndarray, R_pelvis: np.ndarray, camera: Camera, radius: float, side: str
) -> list[Disc | None]:
    """Return where a ball beside a hip is seen; None without a bag."""
    if radius == 0:
        return [None] * len(joints)
    outward = 1.0 if side == "left" else -1.0
    beside = np.array([outward * (HIP_TO_SIDE + radius / 2), -0.06, -0.02])
    centres = joints[:, JOINTS.index(f"{side}_hip")] + R_pelvis @ beside
    pixels = camera.project(centres)
    return [
        Disc(*map(float, pixel), radius * _scale(camera, centre))
        for pixel, centre in zip(pixels, centres, strict=True)
    ]


def _scale(camera: Camera, point: np.ndarray) -> float:
    """Return pixels per metre at the depth of a point."""
    return float(camera.fx / camera.depths(point))
