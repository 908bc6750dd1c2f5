"""Calibrated cameras that film one person together, and the points that they see in space.

A calibration is a TOML file with a table for each camera, as Pose2Sim, anipose and FreeMoCap write
it: ``name``, ``size``, ``matrix``, ``distortions`` and ``rotation``, ``translation`` from the world
to the camera. Points X follow from where the cameras see them:

1. ``min Σ_c log(1 + |π_c(X) - x_c|² / τ²)``

by iteratively reweighted direct linear transformation (Hartley and Zisserman, *Multiple View
Geometry*, ch. 12): one camera that is far off is outvoted.
"""

from __future__ import annotations

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from gva_mi.body import so3
from gva_mi.core.errors import InputError, expecting
from gva_mi.core.files import require_file

CALIBRATION = (
    "a camera's name, size, matrix, distortions, rotation and translation, as in Pose2Sim's, "
    "anipose's or FreeMoCap's calibration"
)
ROUNDS = 10  # of reweighting, and of undoing the distortion


@dataclass(frozen=True)
class CalibratedCamera:
    """A camera of a calibration, whose axes are x right, y down, z away."""

    name: str
    size: tuple[int, int]  # pixels
    K: np.ndarray  # (3, 3) pixels
    distortion: np.ndarray  # (4,) or (5,) of OpenCV
    R: np.ndarray  # (3, 3) from the world
    t: np.ndarray  # (3,) metres

    def rays(self, pixels: np.ndarray) -> np.ndarray:
        """Return x / z and y / z (..., 2) of points, by fixed-point iteration."""
        k1, k2, p1, p2, k3 = (*self.distortion, 0.0)[:5]
        seen = (pixels - self.K[:2, 2]) / self.K[[0, 1], [0, 1]]
        x = seen
        for _ in range(ROUNDS):
            r2, xy = np.square(x).sum(-1, keepdims=True), x.prod(-1, keepdims=True)
            aside = 2 * xy * [p1, p2] + (r2 + 2 * np.square(x)) * [p2, p1]
            x = (seen - aside) / (1 + r2 * (k1 + r2 * (k2 + r2 * k3)))
        return x

    def place(self, X: np.ndarray) -> np.ndarray:
        """Return points (..., 3) of the world in the camera's axes."""
        return X @ self.R.T + self.t


def read_calibration(path: Path) -> list[CalibratedCamera]:
    """Read the cameras of a calibration; tables without a matrix are ignored.

    Raises:
        InputError: the file is not one.
    """
    require_file(path, CALIBRATION)
    with expecting(path, CALIBRATION):
        tables = tomllib.loads(path.read_text())
        tables = {name: table for name, table in tables.items() if "matrix" in table}
        found = [_camera(name, table) for name, table in tables.items()]
    for name, table in tables.items():
        if table.get("fisheye") or np.size(table["distortions"]) not in (4, 5):
            raise InputError(
                f"{path}: {name} is a fisheye, or has not 4 or 5 distortions; expected a lens of "
                "OpenCV with k1, k2, p1, p2 and perhaps k3"
            )
    if len(found) < 2:
        raise InputError(f"{path}: expected at least two cameras, found {len(found)}")
    return found


def _camera(key: str, table: dict) -> CalibratedCamera:
    K, distortion = np.array(table["matrix"], float), np.array(table["distortions"], float)
    turn = torch.tensor(table["rotation"], dtype=torch.float64)
    width, height = (int(side) for side in table["size"])
    t = np.array(table["translation"], float).reshape(3)
    R = so3.to_matrix(turn.reshape(3)).numpy()
    name = str(table.get("name", key))
    return CalibratedCamera(name, (width, height), K.reshape(3, 3), distortion, R, t)


def triangulate(
    cameras: Sequence[CalibratedCamera], rays: np.ndarray, seen: np.ndarray, tau: np.ndarray
) -> np.ndarray:
    """Minimise eq. 1 from rays (C, N, 2).

    Args:
        cameras: C of them.
        rays: x / z and y / z, of N points.
        seen: (C, N) where a camera saw a point.
        tau: (C,) of x / z.

    Returns:
        X (N, 3) metres; NaN where fewer than two cameras saw a point.
    """
    P = np.stack([np.column_stack([camera.R, camera.t]) for camera in cameras])[:, None]
    x = np.where(seen[..., None], rays, 0)
    rows = x[..., None] * P[:, :, 2:] - P[:, :, :2]  # (C, N, 2, 4)
    weights = seen.astype(float)
    for _ in range(ROUNDS):
        A = (weights[..., None, None] * rows).transpose(1, 0, 2, 3).reshape(len(x[0]), -1, 4)
        X = np.linalg.svd(A, full_matrices=False)[2][:, -1]
        X = X[:, :3] / X[:, 3:]
        local = np.stack([camera.place(X) for camera in cameras])
        off = np.square(local[..., :2] / local[..., 2:] - x).sum(-1)
        weights = seen / (local[..., 2] * np.sqrt(1 + off / tau[:, None] ** 2))
    return np.where((seen.sum(0) >= 2)[:, None], X, np.nan)
