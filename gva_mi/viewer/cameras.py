"""A browser's camera, where it starts, how others fit into its picture, and films between views.

A browser orbits a point about a fixed axis. That axis is the person's own upright, because a video
does not say which way is up.

A film goes from view to view, moving like a browser between them. With c the point that is looked
at, u the axis of the orbits and e1, e2 horizontal axes perpendicular to it,

    eye = c + d (cos(el) (cos(az) e1 + sin(az) e2) + sin(el) u)

and az, el, log d, c and log tan(fov / 2) are each interpolated by monotone cubics (PCHIP), which
are smooth and never overshoot the chosen views. az takes the shorter way round.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from gva_mi.avatar.rig import Rig
from gva_mi.body.pose import Pose
from gva_mi.data.pictures import MOST_PIXELS
from gva_mi.fit.renders import CameraPath, cylinder, shots
from gva_mi.splat import Camera, look_at
from gva_mi.splat.reference import rotation

Vector = tuple[float, float, float]
STEEPEST = np.radians(89.9)  # at 90 degrees the azimuth is undefined
NEAREST = 1e-3  # metres


@dataclass(frozen=True)
class ViewerCamera:
    """The camera of a browser; equal numbers are the same view."""

    position: Vector  # metres, world
    look_at: Vector  # metres, world: what it orbits
    wxyz: tuple[float, float, float, float]  # R_world_camera, OpenCV's axes
    fov: float  # radians, over the height of the picture
    width: int  # pixels
    height: int  # pixels

    def usable(self) -> bool:
        """Return whether a picture can be drawn: a hidden browser has no pixels."""
        numbers = np.array([*self.position, *self.look_at, *self.wxyz, self.fov])
        pixels = min(self.width, self.height) >= 2 and self.width * self.height <= MOST_PIXELS
        unit = abs(np.linalg.norm(self.wxyz) - 1) < 1e-3
        return bool(pixels and np.isfinite(numbers).all() and unit and 0 < self.fov < np.pi)

    def to_camera(self) -> Camera:
        """Return the camera that the renderer uses."""
        R_world_camera = rotation(torch.tensor(self.wxyz, dtype=torch.float64)).numpy()
        T_camera_world = np.eye(4)
        T_camera_world[:3, :3] = R_world_camera.T
        T_camera_world[:3, 3] = -R_world_camera.T @ np.array(self.position)
        return lens(self.fov, self.width, self.height, T_camera_world)


@dataclass(frozen=True)
class Start:
    """The view that browsers start with."""

    position: np.ndarray  # (3,) metres
    look_at: np.ndarray  # (3,) metres
    up: np.ndarray  # (3,) unit: the axis of their orbits
    fov: float  # radians


def start(rig: Rig, motion: Pose) -> Start:
    """Return a view from in front of the person that shows all of the motion."""
    camera, around = shots(CameraPath("static"), rig, motion)[0].camera, cylinder(rig, motion)
    fov = 2 * np.arctan(camera.height / (2 * camera.fy))
    return Start(camera.position, around.centre, around.up, float(fov))


def lens(fov: float, width: int, height: int, T_camera_world: np.ndarray) -> Camera:
    """Return a camera by its vertical field of view, radians."""
    focal = height / (2 * np.tan(fov / 2))
    return Camera(focal, focal, width / 2, height / 2, T_camera_world, width, height)


def fitted(camera: Camera, width: int, height: int) -> Camera:
    """Return a camera whose picture is centred in one of another size.

    Margins show what the camera would have seen there.
    """
    inner = camera.resized(*inscribed(camera.width, camera.height, width, height))
    left, top = (width - inner.width) // 2, (height - inner.height) // 2
    return inner.cropped(-left, -top, width, height)


def inscribed(width: int, height: int, in_width: int, in_height: int) -> tuple[int, int]:
    """Return the size of a picture scaled to fit into another."""
    scale = min(in_width / width, in_height / height)
    return max(1, round(width * scale)), max(1, round(height * scale))


def coarser(camera: Camera, pixels: int) -> Camera:
    """Return the same view with at most so many pixels."""
    scale = min(1.0, (pixels / (camera.width * camera.height)) ** 0.5)
    return camera.resized(max(1, int(camera.width * scale)), max(1, int(camera.height * scale)))


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
