"""Remove lens distortion from pictures; the result is a pinhole's picture with the same K.

With x = (u − cx)/fx, y = (v − cy)/fy and r² = x² + y², the lens shows at (x', y') what a pinhole
shows at (x, y), as OpenCV has it, with coefficients (k1, k2, p1, p2, k3):

    x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2 x²),    y' alike.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch

from gva_mi.core.errors import InputError


def undistort(
    where: object, K: np.ndarray, coefficients: np.ndarray | None, size: tuple[int, int]
) -> Callable[[np.ndarray], np.ndarray] | None:
    """Return a function that undistorts an 8-bit picture (H, W[, C]); None for a pinhole.

    ``coefficients`` are 4 or 5; all zero, or None: a pinhole. ``size`` is (W, H).
    """
    c = np.ravel(np.asarray(np.zeros(5) if coefficients is None else coefficients, np.float64))
    if len(c) not in (4, 5) or not np.isfinite(c).all():
        raise InputError(f"{where}: distortion must be (k1, k2, p1, p2, k3), got {c}")
    if not c.any():
        return None
    k1, k2, p1, p2, k3 = (*c, 0.0)[:5]
    u, v = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
    x, y = (u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    u = K[0, 0] * (x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)) + K[0, 2]
    v = K[1, 1] * (y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y) + K[1, 2]
    # grid_sample counts from −1 at one border of the picture to 1 at the other.
    place = np.stack([2 * u / size[0] - 1, 2 * v / size[1] - 1], axis=-1)
    grid = torch.from_numpy(place.astype(np.float32))[None]

    def undistorted(image: np.ndarray) -> np.ndarray:
        planes = torch.from_numpy(np.atleast_3d(image).astype(np.float32)).permute(2, 0, 1)[None]
        found = torch.nn.functional.grid_sample(planes, grid, align_corners=False)
        found = found[0].permute(1, 2, 0).round().clamp(0, 255).to(torch.uint8).numpy()
        return found.reshape(image.shape)

    return undistorted
