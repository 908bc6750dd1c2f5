"""Where a posed body's joints are: in the world, in a picture, and in a mask."""

from __future__ import annotations

import numpy as np
import torch

from gva_mi.body.kinematics import joint_transforms
from gva_mi.body.pose import PARENTS
from gva_mi.splat import Camera


def joints_in_world(rotations: np.ndarray, transl: np.ndarray, joints: np.ndarray) -> np.ndarray:
    """Return joint positions (T, 55, 3), metres, under ``rotations`` (T, 55, 3) axis-angle.

    ``transl`` is (T, 3); ``joints`` are (55, 3) of the body at rest.
    """
    rotations, rest, transl = (
        torch.from_numpy(np.array(x, np.float64)) for x in (rotations, joints, transl)
    )
    T = joint_transforms(rotations, rest, PARENTS, transl).numpy()
    return np.einsum("tjab,jb->tja", T[..., :3, :3], joints) + T[..., :3, 3]


def joints_seen(camera: Camera, places: np.ndarray) -> np.ndarray:
    """Project joints (J, 3), metres, world, to pixels (J, 2); infinite behind the camera."""
    depth = places @ camera.T_camera_world[2, :3] + camera.T_camera_world[2, 3]
    with np.errstate(all="ignore"):
        return np.where(depth[:, None] > 0, camera.project(places), np.inf)


def count_in_mask(pixels: np.ndarray, mask: np.ndarray) -> tuple[int, int]:
    """Count the joints (J, 2) pixels that lie in a mask (H, W) bool, and those in the picture."""
    height, width = mask.shape
    u, v = np.floor(np.nan_to_num(pixels, nan=-1.0, posinf=-1.0, neginf=-1.0).clip(-1, 1e6)).T
    seen = (u >= 0) & (v >= 0) & (u < width) & (v < height)
    return int(mask[v[seen].astype(int), u[seen].astype(int)].sum()), int(seen.sum())
