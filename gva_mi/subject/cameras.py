"""The cameras of a video: ``cameras.npz``."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gva_mi.core.errors import InputError, expecting
from gva_mi.core.files import read_arrays, require_array, require_keys, write_arrays
from gva_mi.core.options import Within
from gva_mi.splat import Camera
from gva_mi.subject.pictures import require_size

# Chosen: wider than any lens, from a fisheye to a telescope.
FOCAL_PER_SIDE = Within(0.01, 1e6, unit="times the picture's longer side")
# Rows, and the largest entry (pixels, metres). Chosen: far beyond any camera.
_ROWS_AND_LARGEST = {"K": (3, 1e9), "T_camera_world": (4, 1e6)}


def load_cameras(
    path: Path, count: int | None = None, of: str = ", but the video has {} frames"
) -> list[Camera]:
    """Read ``cameras.npz``: the camera of each frame.

    Args:
        path: the file.
        count: how many cameras there have to be; a single one in the file is repeated. None: any.
        of: how an error about another count ends; ``{}`` becomes ``count``.
    """
    data = read_arrays(path, "K, T_camera_world, width, height (.npz)")
    require_keys(path, data, ("K", "T_camera_world", "width", "height"))
    K, T = (_matrices(path, name, data[name]) for name in ("K", "T_camera_world"))
    width, height = (_pixels(path, name, data[name]) for name in ("width", "height"))
    require_size(str(path), width, height)
    mirrored = [k for k, R in enumerate(T[:, :3, :3]) if np.linalg.det(R) < 0]
    if mirrored:
        raise InputError(
            f"{path}: 'T_camera_world' of camera {mirrored[0]} is mirrored (its determinant is "
            "below 0); expected x right, y down, z forward"
        )
    found = max(len(K), len(T))
    if not {len(K), len(T)} <= {1, found}:
        raise InputError(f"{path}: holds {len(K)} 'K', but {len(T)} 'T_camera_world'")
    K, T = np.broadcast_to(K, (found, 3, 3)), np.broadcast_to(T, (found, 4, 4))
    with expecting(path, "cameras that see something"):
        cameras = [Camera.from_matrices(K[k], T[k], width, height) for k in range(found)]
    for k, camera in enumerate(cameras):
        for focal in (camera.fx, camera.fy):
            share = focal / max(width, height)
            FOCAL_PER_SIDE.require(str(path), f"the focal length of camera {k} in 'K'", share)
    if found == 1 and count is not None:
        cameras *= count
    if count not in (None, len(cameras)):
        raise InputError(f"{path}: holds {len(cameras)} cameras{of.format(count)}")
    return cameras


def _matrices(path: Path, name: str, value: np.ndarray) -> np.ndarray:
    """Validate K (3, 3) or T_camera_world (4, 4), of one camera or n; return (n, ., .)."""
    n, largest = _ROWS_AND_LARGEST[name]
    value = require_array(path, name, value, (n, n), (None, n, n), kind="iuf", largest=largest)
    value = value.reshape(-1, n, n)
    # Another last row means that K is not normalised, or that the matrix is transposed.
    last = [0] * (n - 1) + [1]
    if bad := [row for row in value[:, -1] if any(row != last)]:
        raise InputError(f"{path}: the last row of '{name}' must be {last}, got {bad[0].tolist()}")
    if not len(value):
        raise InputError(f"{path}: '{name}' is empty")
    return value


def _pixels(path: Path, name: str, value: np.ndarray) -> int:
    """Read a width or height in pixels."""
    number = value.dtype.kind in "iuf" and value.size == 1
    if not number or not np.isfinite(value).all() or value.item() != int(value.item()):
        raise InputError(f"{path}: '{name}' must be a whole number of pixels, got {value}")
    return int(value.item())


def depths(cameras: Sequence[Camera], points: np.ndarray) -> np.ndarray:
    """Return the depths (T,) of points (T, 3), world, each before its own camera, metres."""
    T = np.stack([camera.T_camera_world for camera in cameras])
    return (T[:, 2, :3] * points).sum(1) + T[:, 2, 3]


def save_cameras(path: Path, cameras: Sequence[Camera]) -> None:
    """Write ``cameras.npz``; equal cameras are written once."""
    K = np.stack([c.K for c in cameras])
    T = np.stack([c.T_camera_world for c in cameras])
    if (K == K[:1]).all() and (T == T[:1]).all():
        K, T = K[0], T[0]
    size = {"width": np.array(cameras[0].width), "height": np.array(cameras[0].height)}
    write_arrays(path, K=K, T_camera_world=T, **size)
