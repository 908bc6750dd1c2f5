"""Cameras that go round a person: a turntable, an orbit, or one that stands.

Which way is up in the world, a video does not say. So cameras go round the person's own upright

    u = Σ_k R_k e_y / |·|      R_k: how the root is turned in frame k of the motion

for bodies stand along y at rest, and begin where the person looks to in the first frame. They are
as far away as it takes to see all of the motion, and look at the middle of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
import torch

from gva_mi.avatar.avatar import Rig
from gva_mi.body.kinematics import joint_transforms
from gva_mi.body.pose import Pose
from gva_mi.body.skinning import skin_points
from gva_mi.core.options import Within, require_ranges
from gva_mi.data.pictures import MOST_PIXELS, require_size
from gva_mi.splat import Camera, look_at

Kind = Literal["turntable", "orbit", "static"]
_TURN = 72  # pictures of a turntable, unless another number is asked for
_FOCAL = 2.0  # focal length / longer side of the picture: little perspective, as in a portrait
_MARGIN = 1.1  # room around the person in the picture: hair and hems lie outside the body
_EVERY = 16  # vertices; one of so many tells how large a person is


@dataclass(frozen=True)
class CameraPath:
    """How cameras see the person.

    On a turntable one pose is seen from all around. An orbit goes round once while the motion
    plays. A static camera stands while it does.
    """

    path: Kind | None = None  # none: static, or a turntable where no poses are given
    # Pictures; 0: 72 of a turntable, otherwise one a frame of the motion.
    frames: Annotated[int, Within(0, 100_000)] = 0
    # From where the person looks to, where the first camera stands.
    turn: Annotated[float, Within(-3600, 3600, unit="degrees")] = 0.0
    # That cameras stand higher than the middle of the person.
    elevation: Annotated[float, Within(-89, 89, unit="degrees")] = 5.0
    distance: Annotated[float, Within(0, 100, "low")] = 1.0  # times that from which all is seen
    # Width and height, pixels.
    size: tuple[Annotated[int, Within(1, MOST_PIXELS)], Annotated[int, Within(1, MOST_PIXELS)]] = (
        512,
        640,
    )

    def __post_init__(self) -> None:
        require_ranges("cameras", self)
        require_size("cameras", *self.size)

    def or_usual(self, moving: bool) -> CameraPath:
        """With a ``path``: where none is given, static for a motion, else a turntable."""
        return replace(self, path=self.path or ("static" if moving else "turntable"))


@dataclass(frozen=True)
class Shot:
    """One picture to be taken."""

    frame: int  # of the motion
    camera: Camera


def shots(options: CameraPath, rig: Rig, motion: Pose, held: int = 0) -> list[Shot]:
    """The pictures of a path, in their order.

    Args:
        options: with a ``path``.
        rig: the person's rest body.
        motion: T frames; where more pictures than that are wanted, it begins again.
        held: the frame whose pose is on the turntable.
    """
    T, still = len(motion), options.path == "turntable"
    count = options.frames or (_TURN if still else T)
    frames = [held if still else k % T for k in range(count)]
    stage = _stage(rig, motion[held] if still else motion[: max(frames) + 1])
    width, height = options.size
    focal = _FOCAL * max(width, height)
    fits = max(stage.height / height, 2 * stage.radius / width) * focal
    distance = options.distance * (stage.radius + _MARGIN * fits)
    angle = math.radians(options.turn)
    angles = angle + np.linspace(0, 2 * np.pi, count, endpoint=False)
    if options.path == "static":
        angles = np.full(count, angle)
    elevation = math.radians(options.elevation)
    toward = distance * math.cos(elevation) * stage.front
    views = circle(stage.centre, toward, stage.up, math.tan(elevation), angles)
    lens = (focal, focal, width / 2, height / 2)
    return [Shot(k, Camera(*lens, v, width, height)) for k, v in zip(frames, views, strict=True)]


def circle(
    centre: np.ndarray, toward: np.ndarray, up: np.ndarray, rise: float, angles: Iterable[float]
) -> Iterator[np.ndarray]:
    """``T_camera_world`` (4, 4) of cameras on a circle that look at its middle.

    Args:
        centre: (3,) metres.
        toward: (3,) from there to below the camera at angle 0, at right angles to ``up``.
        up: (3,) unit.
        rise: how much higher the circle lies than the centre, in its radii.
        angles: radians, counter-clockwise seen from above.
    """
    across = np.cross(up, toward)
    for angle in angles:
        eye = centre + np.cos(angle) * toward + np.sin(angle) * across
        yield look_at(eye + rise * np.linalg.norm(toward) * up, centre, up)


@dataclass(frozen=True)
class _Stage:
    """The upright cylinder in which a motion takes place."""

    centre: np.ndarray  # (3,) metres, world
    up: np.ndarray  # (3,) unit
    front: np.ndarray  # (3,) unit, level: where the person looks to in the first frame
    radius: float  # metres
    height: float  # metres


@torch.no_grad()
def _stage(rig: Rig, motion: Pose) -> _Stage:
    """Where a motion takes place."""
    maps = joint_transforms(motion.rotations, rig.joints, rig.parents, motion.transl)
    some = slice(None, None, _EVERY)
    points = skin_points(rig.vertices[some], rig.weights[some], maps).double().numpy()
    root = maps[:, 0, :3, :3].double().numpy()  # columns: to the left, up, ahead
    up = root[:, :, 1].mean(0)
    if np.linalg.norm(up) < 0.1:  # somersaults have no mean: take the first frame's
        up = root[0, :, 1]
    up = up / np.linalg.norm(up)
    left, _, ahead = root[0].T
    if abs(up @ ahead) > 0.99:  # who looks straight up or down
        ahead = np.cross(left, up)
    front = ahead - up * (up @ ahead)
    front /= np.linalg.norm(front)
    axes = np.stack([np.cross(up, front), up, front])
    seen = (points @ axes.T).reshape(-1, 3)
    low, high = seen.min(0), seen.max(0)
    middle = (low + high) / 2
    radius = float(np.linalg.norm((seen - middle)[:, [0, 2]], axis=1).max())
    return _Stage(middle @ axes, up, front, radius, float(high[1] - low[1]))
