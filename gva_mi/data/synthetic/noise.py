"""Errors of the data that a real pipeline has in place of the truth; level 1 is usual, 0 is exact.

* Poses, as an estimator on single frames gives them: errors grow toward hands and feet, come in
  bursts of some frames, and are twice as large where the person stands sideways; depth is known
  worst; now and then a hand is lost, and its mean pose is given instead.
* Masks, as a segmenter gives them: the boundary wobbles by a pixel or two, with some notches.
* Normals, as a network gives them: blurred, and turned by a slowly varying error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import roma
import torch

from gva_mi.body.pose import JOINTS, LEFT_HAND, RIGHT_HAND, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.splat import Camera

# Level 1. Root mean square rotation errors in radians, before the doubling at the side. They grow
# along the limbs; what leans the whole trunk is known best.
ROTATION: Mapping[str, float] = {
    "pelvis": 0.045, "spine1": 0.02, "spine2": 0.02, "spine3": 0.02, "neck": 0.05, "head": 0.07,
    "collar": 0.03, "shoulder": 0.055, "elbow": 0.095, "wrist": 0.16,
    "hip": 0.06, "knee": 0.085, "ankle": 0.15, "foot": 0.15,
}  # fmt: skip
FACE, FINGER = 0.02, 0.16  # jaw and eyes; every joint of the fingers
DEPTH, ASIDE = 0.028, 0.008  # m, translation along the line of sight, and across it
BETAS = 0.25  # standard deviations
EXPRESSION = 0.3  # standard deviations, of every coefficient that moves at all
MEMORY = 5.0  # frames over which an error persists

# Bursts: for some frames the errors of one group of joints grow.
CALM, BURST = 0.66, 3.1  # factors on the sizes above: at rest; at the height of a burst, at most
BURST_EVERY, BURST_LENGTH = 25.0, 2.5  # frames between bursts, on average; half length of one
GROUPS: Sequence[Sequence[str]] = (
    ("left_collar", "left_shoulder", "left_elbow", "left_wrist"),
    ("right_collar", "right_shoulder", "right_elbow", "right_wrist"),
    ("left_hip", "left_knee", "left_ankle", "left_foot"),
    ("right_hip", "right_knee", "right_ankle", "right_foot"),
)

# Drop-outs: an estimator that loses a hand returns the mean hand on a straight wrist.
LOST = 0.08  # share of all frames in which a hand is lost
LOST_FRAMES = 5.0  # length of a drop-out, on average
MEAN_FINGER = 0.3  # rad, how far the fingers of the mean hand curl

SIDES = ("left", "right")

# Pixels at 512², scaled with the width of the picture.
WOBBLE, WOBBLE_LENGTH = 1.1, 14.0  # boundary error of a mask, and the length over which it varies
NOTCHES, NOTCH_RADIUS = 4, 4.0  # dents and bumps on a mask's boundary: how many, how large
BLUR = 2.2  # of the normals
TILT, TILT_LENGTH = 0.14, 50.0  # rad, px: error of the normals, the length over which it varies


@dataclass(frozen=True)
class PoseError:
    """Distance of noisy from true poses: vertices in millimetres, rotations in degrees."""

    vertex_mm: float
    hand_vertex_mm: float
    foot_vertex_mm: float
    rotation_deg: float
    transl_mm: float
    sideways: float  # rotation error where the person stands sideways, over that from front or back
    lost_left_hand: tuple[int, ...]  # frames in which the hand is lost
    lost_right_hand: tuple[int, ...]


def noisy_poses(
    pose: Pose, shape: Shape, camera: Camera, level: float, rng: np.random.Generator
) -> tuple[Pose, Shape]:
    """Stage-1 poses of a video.

    Args:
        pose: the truth, T frames.
        shape: the truth.
        camera: the view; it decides what is sideways and what is depth.
        level: 0 returns the truth itself.
        rng: for all errors.
    """
    if level == 0:
        return pose, shape
    frames = len(pose)
    sideways = _sideways(pose, camera)
    strength = level * (1 + sideways**2)[:, None]
    sizes = _sizes()[:, None] * np.full(frames, 1.0)
    for group in GROUPS:
        burst = _bursts(rng, frames)
        for name in group:
            sizes[JOINTS.index(name)] *= burst

    rotations = pose.rotations.double().numpy().copy()
    for joint, size in enumerate(sizes):
        rotations[:, joint] += strength * size[:, None] * _curve(rng, frames)
    for side, hand in (("left", LEFT_HAND), ("right", RIGHT_HAND)):
        lost = min(level, 1.0) * dropped_frames(frames, level, rng)[:, None, None]
        rotations[:, hand] += lost * (_mean_hand(side) - rotations[:, hand])
        wrist = rotations[:, [JOINTS.index(f"{side}_wrist")]]
        rotations[:, [JOINTS.index(f"{side}_wrist")]] = (1 - lost) * wrist
    aside = _curve(rng, frames) * np.array([ASIDE, ASIDE, DEPTH]) * np.sqrt(3)
    R_camera_world = camera.T_camera_world[:3, :3]
    transl = pose.transl.double().numpy() + (strength * aside) @ R_camera_world
    betas = (
        shape.betas + level * BETAS * torch.from_numpy(rng.normal(size=len(shape.betas))).float()
    )
    expression = pose.expression.double().numpy().copy()
    for k in np.flatnonzero(expression.any(0)):
        expression[:, k] += level * EXPRESSION * _curve(rng, frames)[:, 0] * np.sqrt(3)
    tensor = lambda x: torch.from_numpy(x).to(pose.transl.dtype)
    noisy = Pose(tensor(rotations), tensor(transl), tensor(expression))
    return noisy, Shape(betas)


def dropped_frames(frames: int, level: float, rng: np.random.Generator) -> np.ndarray:
    """In which frames a hand is lost, (T,) bool: runs whose share of the frames is ``LOST``."""
    start = level * LOST / (LOST_FRAMES * max(1 - level * LOST, 0.1))  # chance, frame by frame
    lost = np.zeros(frames, dtype=bool)
    for k in np.flatnonzero(rng.random(frames) < start):
        lost[k : k + rng.poisson(LOST_FRAMES - 1) + 1] = True
    return lost


def _bursts(rng: np.random.Generator, frames: int) -> np.ndarray:
    """Factors (T,) on the size of an error: calm, with bursts at random moments."""
    margin = int(3 * BURST_LENGTH)
    t = np.arange(frames)
    envelope = np.full(frames, CALM)
    for centre in range(-margin, frames + margin):
        if rng.random() < 1 / BURST_EVERY:
            height = rng.uniform(0.5, 1.0) * (BURST - CALM)
            bump = height * np.exp(-(((t - centre) / BURST_LENGTH) ** 2) / 2)
            envelope = np.maximum(envelope, CALM + bump)
    return envelope


def _sideways(pose: Pose, camera: Camera) -> np.ndarray:
    """How far a person stands sideways (T,): 0 seen from front or back, 1 from the side."""
    facing = _matrices(pose.rotations[:, 0].double().numpy())[:, :, 2]
    return np.abs(facing @ camera.T_camera_world[0, :3])


def _mean_hand(side: str) -> np.ndarray:
    """Rotations (15, 3) of a relaxed hand."""
    sign = 1.0 if side == "left" else -1.0
    rotations = np.zeros((15, 3))
    rotations[:12, 2] = -sign * MEAN_FINGER  # all but the thumb
    return rotations


def noisy_mask(mask: np.ndarray, level: float, rng: np.random.Generator) -> np.ndarray:
    """A mask (H, W) in [0, 1] with a boundary that is off by a pixel or two at level 1."""
    if level == 0:
        return mask
    from scipy.ndimage import distance_transform_edt, gaussian_filter

    pixel = mask.shape[1] / 512
    inside = mask > 0.5
    distance = distance_transform_edt(inside) - distance_transform_edt(~inside)
    distance += np.where(inside, -0.5, 0.5)  # signed, zero on the boundary, positive inside
    distance = gaussian_filter(distance, 0.6)  # over the steps from pixel to pixel
    length = max(WOBBLE_LENGTH * pixel, 0.7)
    wobble = level * max(WOBBLE * pixel, 0.25) * _field(rng, mask.shape, length)
    edge = np.argwhere(np.abs(distance) < 1)
    for centre in edge[rng.integers(len(edge), size=NOTCHES)] if len(edge) else ():
        radius = level * NOTCH_RADIUS * pixel * rng.uniform(0.4, 1.3)
        rows, columns = np.ogrid[: mask.shape[0], : mask.shape[1]]
        away = np.hypot(rows - centre[0], columns - centre[1])
        notch = np.maximum(radius - away, 0)
        wobble += rng.choice([-1, -1, 1]) * notch
    return np.clip(distance + wobble + 0.5, 0, 1).astype(np.float32)


def noisy_normals(
    normals: np.ndarray, mask: np.ndarray, level: float, rng: np.random.Generator
) -> np.ndarray:
    """Normals (H, W, 3) as a network would give them inside a mask (H, W), blurred and turned."""
    if level == 0:
        return normals
    from scipy.ndimage import distance_transform_edt, gaussian_filter

    pixel = normals.shape[1] / 512
    reach = max(level * BLUR * pixel, 0.3)
    channels = [gaussian_filter(normals[..., k], reach) for k in range(3)]
    blurred = np.stack(channels, axis=-1)
    length = np.linalg.norm(blurred, axis=-1)
    # Where the mask reaches past the surface, the nearest normal is taken.
    rows, columns = distance_transform_edt(
        length < 1e-3, return_distances=False, return_indices=True
    )
    blurred = blurred[rows, columns] / np.maximum(length[rows, columns], 1e-9)[..., None]
    axes = np.stack([_field(rng, mask.shape, TILT_LENGTH * pixel) for _ in range(3)], axis=-1)
    turned = blurred + level * TILT / np.sqrt(2) * np.cross(axes, blurred)
    turned[..., 2] = np.minimum(turned[..., 2], 0)  # what is seen faces the camera
    turned /= np.maximum(np.linalg.norm(turned, axis=-1, keepdims=True), 1e-9)
    return (turned * (mask > 0.5)[..., None]).astype(np.float32)


def pose_error(
    body: BodyModel, pose: Pose, shape: Shape, true: Pose, true_shape: Shape, camera: Camera
) -> PoseError:
    """How far poses are from the truth, the mean over frames and vertices.

    A hand counts as lost where all of its noisy fingers are those of the mean hand.

    Args:
        body: takes both to vertices.
        pose, shape: the noisy ones.
        true, true_shape: the truth.
        camera: tells who stands sideways.
    """
    away = torch.cat([
        (body(a, shape).vertices - body(b, true_shape).vertices).norm(dim=-1)
        for a, b in zip(_chunks(pose), _chunks(true), strict=True)
    ])  # fmt: skip
    weights = body.weights
    of = lambda *names: [JOINTS.index(f"{side}_{name}") for name in names for side in SIDES]
    hand = weights[:, LEFT_HAND.start :].sum(1) + weights[:, of("wrist")].sum(1) > 0.5
    foot = weights[:, of("ankle", "foot")].sum(1) > 0.5
    A, B = (_matrices(p.rotations.double().numpy().reshape(-1, 3)) for p in (pose, true))
    cosine = (np.einsum("nij,nij->n", A, B) - 1) / 2
    degrees = np.degrees(np.arccos(np.clip(cosine, -1, 1))).reshape(len(pose), -1)
    sideways = _sideways(true, camera)
    side, front = degrees[sideways > 0.87].mean(1), degrees[sideways < 0.5].mean(1)  # 30 degrees
    ratio = side.mean() / front.mean() if len(side) and len(front) and front.any() else 1.0
    millimetres = lambda x: float(1000 * x.double().mean())
    lost = lambda hand, side: _lost(pose.rotations[:, hand].numpy(), side)
    return PoseError(
        vertex_mm=millimetres(away),
        hand_vertex_mm=millimetres(away[:, hand]),
        foot_vertex_mm=millimetres(away[:, foot]),
        rotation_deg=float(degrees.mean()),
        transl_mm=millimetres((pose.transl - true.transl).norm(dim=-1)),
        sideways=float(ratio),
        lost_left_hand=lost(LEFT_HAND, "left"),
        lost_right_hand=lost(RIGHT_HAND, "right"),
    )


def _lost(fingers: np.ndarray, side: str) -> tuple[int, ...]:
    """The frames in which fingers (T, 15, 3) are those of the mean hand."""
    off = np.abs(fingers - _mean_hand(side)).max((1, 2))
    return tuple(np.flatnonzero(off < 1e-5).tolist())


def _chunks(pose: Pose, frames: int = 32) -> list[Pose]:
    return [pose[k : k + frames] for k in range(0, len(pose), frames)]


def mask_iou(mask: np.ndarray, true: np.ndarray) -> float:
    """Intersection over union of two masks in [0, 1], cut at one half."""
    a, b = mask > 0.5, true > 0.5
    return float((a & b).sum() / max((a | b).sum(), 1))


def normal_error(normals: np.ndarray, true: np.ndarray) -> float:
    """Mean angle in degrees between normals, where both are."""
    both = (np.abs(normals).sum(-1) > 0) & (np.abs(true).sum(-1) > 0)
    cosine = (normals[both] * true[both]).sum(-1)
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean()) if both.any() else 0.0


def _sizes() -> np.ndarray:
    """Root mean square error of each joint's rotation, radians, (55,)."""
    sizes = [ROTATION.get(name.split("_")[-1], FACE) for name in JOINTS]
    sizes = np.array(sizes)
    sizes[LEFT_HAND] = sizes[RIGHT_HAND] = FINGER
    return sizes


def _curve(rng: np.random.Generator, frames: int) -> np.ndarray:
    """A smooth random curve (T, 3) whose root mean square length is 1."""
    from scipy.ndimage import gaussian_filter1d

    margin = int(3 * MEMORY)
    noise = gaussian_filter1d(rng.normal(size=(frames + 2 * margin, 3)), MEMORY, axis=0)
    noise = noise[margin : margin + frames]
    return noise / np.sqrt((noise**2).sum(1).mean())


def _field(rng: np.random.Generator, shape: tuple[int, int], length: float) -> np.ndarray:
    """A smooth random image of unit variance that varies over ``length`` pixels."""
    from scipy.ndimage import zoom

    nodes = [int(np.ceil(n / length)) + 3 for n in shape]  # a lattice that is interpolated
    scale = max((n + 2 * length) / k for n, k in zip(shape, nodes, strict=True))
    fine = zoom(rng.normal(size=nodes), scale, order=3)
    top, left = ((f - n) // 2 for f, n in zip(fine.shape, shape, strict=True))
    image = fine[top : top + shape[0], left : left + shape[1]]
    return image / image.std()


def _matrices(rotvecs: np.ndarray) -> np.ndarray:
    return roma.rotvec_to_rotmat(torch.from_numpy(rotvecs)).numpy()
