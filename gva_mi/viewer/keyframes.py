"""Interpolate views of a browser to the cameras of a film.

A camera moves like a browser between them. With c the point that is looked at, u the axis of the
orbits and e1, e2 horizontal axes perpendicular to it,

    eye = c + d (cos(el) (cos(az) e1 + sin(az) e2) + sin(el) u)

and az, el, log d, c and log tan(fov / 2) are each interpolated by monotone cubics (PCHIP), which
are smooth and never overshoot the chosen views. az takes the shorter way round.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gva_mi.splat import Camera, look_at
from gva_mi.viewer.cameras import ViewerCamera, lens

STEEPEST = np.radians(89.9)  # at 90 degrees the azimuth is undefined
NEAREST = 1e-3  # metres


def film(
    views: Sequence[ViewerCamera], up: np.ndarray, count: int, width: int, height: int
) -> list[Camera]:
    """Return ``count`` cameras that go from the first view to the last in equal times.

    A single view gives one camera. ``up`` (3,) is the unit axis of the orbits.
    """
    across = _level(up)
    keys = np.stack([_orbit(view, up, across) for view in views])
    keys[:, 0] = np.unwrap(keys[:, 0])
    if len(views) > 1:
        from scipy.interpolate import PchipInterpolator

        times = np.linspace(0, len(views) - 1, count)
        keys = PchipInterpolator(np.arange(len(views)), keys)(times)
    return [_camera(key, up, across, width, height) for key in keys]


def _level(up: np.ndarray) -> np.ndarray:
    """Return e1 and e2, (2, 3)."""
    e1 = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    e1 /= np.linalg.norm(e1)
    return np.stack([e1, np.cross(up, e1)])


def _orbit(view: ViewerCamera, up: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Return az, el, log d, c (3,) and log tan(fov / 2) of a view, (7,)."""
    centre = np.array(view.look_at)
    away = np.array(view.position) - centre
    distance = max(np.linalg.norm(away), NEAREST)
    e1, e2 = across @ away
    elevation = np.arctan2(up @ away, np.hypot(e1, e2))
    elevation = np.clip(elevation, -STEEPEST, STEEPEST)
    zoom = np.log(np.tan(view.fov / 2))
    return np.array([np.arctan2(e2, e1), elevation, np.log(distance), *centre, zoom])


def _camera(key: np.ndarray, up: np.ndarray, across: np.ndarray, *size: int) -> Camera:
    azimuth, elevation, distance, *centre, zoom = key
    level = np.cos(azimuth) * across[0] + np.sin(azimuth) * across[1]
    away = np.exp(distance) * (np.cos(elevation) * level + np.sin(elevation) * up)
    fov = 2 * np.arctan(np.exp(zoom))
    return lens(fov, *size, look_at(centre + away, np.array(centre), up))
