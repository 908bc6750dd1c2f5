"""Place a camera so that a whole surface fits into its picture."""

from __future__ import annotations

import numpy as np

from gva_mi.splat import Camera, look_at

FOCAL = 1.45  # focal length over the width of the picture
MARGIN = 0.06  # share of the picture kept free around the person


def camera_around(
    surface: np.ndarray, size: int, azimuth: float = 0.0, elevation: float = 0.06
) -> Camera:
    """Return a camera that sees all points (..., 3) of a surface, metres.

    Its picture has ``size`` x ``size`` pixels and a principal point off-centre, as in crops. The
    azimuth is around the vertical, 0 in front; both angles are in radians.
    """
    points = surface.reshape(-1, 3)
    # Points may be left out, because the margin has room for them.
    points = points[:: max(1, len(points) // 50_000)].astype(np.float64)
    middle = (points.min(0) + points.max(0)) / 2
    flat = np.cos(elevation)
    away = np.array([np.sin(azimuth) * flat, np.sin(elevation), np.cos(azimuth) * flat])
    centre = np.array([0.515, 0.485]) * size
    free = (0.485 - MARGIN) * size
    distance = 2.0
    for _ in range(30):  # move until it just fits; converges geometrically
        T_camera_world = look_at(middle + distance * away, middle)
        camera = Camera(FOCAL * size, FOCAL * size, *centre, T_camera_world, size, size)
        reach = np.abs(camera.project(points) - centre).max() / free
        distance *= max(reach, 0.2)
        if abs(reach - 1) < 1e-4:
            break
    return camera
