"""Measure how far estimated poses, masks and normals are from the ground truth."""

from __future__ import annotations

import numpy as np
import torch

from gva_mi.body.pose import JOINTS, LEFT_HAND, RIGHT_HAND, Pose, Shape
from gva_mi.body.rotations import to_matrices
from gva_mi.body.smplx import BodyModel
from gva_mi.splat import Camera
from gva_mi.synthetic.error_models.outliers import SIDES, mean_hand
from gva_mi.synthetic.error_models.poses import sideways


def pose_error(
    body: BodyModel, pose: Pose, shape: Shape, true: Pose, true_shape: Shape, camera: Camera
) -> dict[str, float | list[int]]:
    """Return the mean errors of poses over frames, millimetres and degrees, for ``noise.json``.

    ``sideways`` is the rotation error seen from the side, over that from front or back, as the
    camera sees them. A hand is lost in the frames where all its fingers are those of the mean hand.
    """
    away = torch.cat([
        (body(a, shape).vertices - body(b, true_shape).vertices).norm(dim=-1)
        for a, b in zip(_chunks(pose), _chunks(true), strict=True)
    ])  # fmt: skip
    weights = body.weights
    of = lambda *names: [JOINTS.index(f"{side}_{name}") for name in names for side in SIDES]
    hand = weights[:, LEFT_HAND.start :].sum(1) + weights[:, of("wrist")].sum(1) > 0.5
    foot = weights[:, of("ankle", "foot")].sum(1) > 0.5
    A, B = (to_matrices(p.rotations.reshape(-1, 3).numpy()) for p in (pose, true))
    cosine = (np.einsum("nij,nij->n", A, B) - 1) / 2
    degrees = np.degrees(np.arccos(np.clip(cosine, -1, 1))).reshape(len(pose), -1)
    turned = sideways(true, camera)
    side, front = degrees[turned > 0.87].mean(1), degrees[turned < 0.5].mean(1)  # 30 degrees
    ratio = side.mean() / front.mean() if len(side) and len(front) and front.any() else 1.0
    millimetres = lambda x: float(1000 * x.double().mean())
    off = lambda hand, side: np.abs(pose.rotations[:, hand].numpy() - mean_hand(side)).max((1, 2))
    lost = lambda hand, side: np.flatnonzero(off(hand, side) < 1e-5).tolist()
    return {
        "vertex_mm": millimetres(away),
        "hand_vertex_mm": millimetres(away[:, hand]),
        "foot_vertex_mm": millimetres(away[:, foot]),
        "rotation_deg": float(degrees.mean()),
        "transl_mm": millimetres((pose.transl - true.transl).norm(dim=-1)),
        "sideways": float(ratio),
        "lost_left_hand": lost(LEFT_HAND, "left"),
        "lost_right_hand": lost(RIGHT_HAND, "right"),
    }


def _chunks(pose: Pose, frames: int = 32) -> list[Pose]:
    return [pose[k : k + frames] for k in range(0, len(pose), frames)]


def mask_iou(mask: np.ndarray, true: np.ndarray) -> float:
    """Return the intersection over union of two masks in [0, 1], cut at one half."""
    a, b = mask > 0.5, true > 0.5
    return float((a & b).sum() / max((a | b).sum(), 1))


def normal_error(normals: np.ndarray, true: np.ndarray) -> float:
    """Return the mean angle between normals in degrees, where both exist."""
    both = (np.abs(normals).sum(-1) > 0) & (np.abs(true).sum(-1) > 0)
    cosine = (normals[both] * true[both]).sum(-1)
    return float(np.degrees(np.arccos(np.clip(cosine, -1, 1))).mean()) if both.any() else 0.0
