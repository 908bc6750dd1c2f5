"""Renders of an avatar as 8-bit pictures, and cameras around a person to render them from.

A video does not say which way is up in the world. So cameras circle around the person's own upright

    u = Σ_k R_k e_y / |·|      R_k: rotation of the root in frame k of the motion

because bodies stand along y at rest. They start where the person faces in the first frame, look at
the middle of the motion, and stand far enough away to see all of it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
import torch

from gva_mi.avatar.avatar import AVATAR_SPLATTING, Avatar
from gva_mi.avatar.rig import Rig
from gva_mi.body.kinematics import joint_transforms
from gva_mi.body.pose import Pose
from gva_mi.body.skinning import skin_points
from gva_mi.core.console import Progress
from gva_mi.core.options import PythonOnly, Within, options_of
from gva_mi.splat import Camera, Gaussians, look_at, render
from gva_mi.subject.pictures import MOST_PIXELS, in_8_bits, require_size
from gva_mi.subject.video import Frame

PathSide = Annotated[int, Within(1, MOST_PIXELS)]
Kind = Literal["turntable", "orbit", "static"]
_TURNTABLE_VIEWS = 72  # default number of pictures; chosen: 5 degrees from one to the next
FOCAL_RATIO = 2.0  # focal length / longer side; chosen: little perspective, as in a portrait
ROOM_AROUND = 1.1  # factor on the distance; chosen: hair and hems reach out of the body
_VERTEX_STRIDE = 16  # chosen: every 16th vertex measures the person


@options_of("cameras")
class CameraPath:
    """Options of a path of cameras around the person.

    A turntable shows one pose from all around. An orbit goes round once while the motion plays. A
    static camera does not move.
    """

    path: Kind | None = None  # none: static, or a turntable if no poses are given
    # Pictures; 0: 72 of a turntable, otherwise one per frame of the motion.
    frames: PythonOnly[Annotated[int, Within(0, 100_000)]] = 0
    # Angle of the first camera from the direction that the person faces.
    turn: Annotated[float, Within(-3600, 3600, unit="degrees")] = 0.0
    # Angle of the cameras above the middle of the person.
    elevation: Annotated[float, Within(-89, 89, unit="degrees")] = 5.0
    size: tuple[PathSide, PathSide] = (512, 640)  # width and height, pixels

    def __post_init__(self) -> None:
        require_size("cameras", *self.size)

    def or_usual(self, moving: bool) -> CameraPath:
        """Fill in a missing ``path``: static for a motion, else a turntable."""
        return replace(self, path=self.path or ("static" if moving else "turntable"))


@dataclass(frozen=True)
class CameraShot:
    """One picture of a path: a frame and a camera."""

    frame: int  # of the motion
    camera: Camera


def shots(options: CameraPath, rig: Rig, motion: Pose) -> list[CameraShot]:
    """Return the pictures of a path in order.

    The motion of T frames repeats if more pictures are wanted; a turntable shows the first frame.
    """
    T, still = len(motion), options.path == "turntable"
    count = options.frames or (_TURNTABLE_VIEWS if still else T)
    frames = [0 if still else k % T for k in range(count)]
    around = cylinder(rig, motion[0] if still else motion[: max(frames) + 1])
    width, height = options.size
    focal = FOCAL_RATIO * max(width, height)
    fits = max(around.height / height, 2 * around.radius / width) * focal
    distance = around.radius + ROOM_AROUND * fits
    angle = math.radians(options.turn)
    angles = angle + np.linspace(0, 2 * np.pi, count, endpoint=False)
    if options.path == "static":
        angles = np.full(count, angle)
    elevation = math.radians(options.elevation)
    ahead = distance * math.cos(elevation) * around.front
    across = np.cross(around.up, ahead)  # counter-clockwise seen from above
    rise = math.tan(elevation) * np.linalg.norm(ahead) * around.up
    taken = []
    for k, turned in zip(frames, angles, strict=True):
        eye = around.centre + np.cos(turned) * ahead + np.sin(turned) * across + rise
        T_camera_world = look_at(eye, around.centre, around.up)
        lens = (focal, focal, width / 2, height / 2)
        taken.append(CameraShot(k, Camera(*lens, T_camera_world, width, height)))
    return taken


@dataclass(frozen=True)
class UprightCylinder:
    """The upright cylinder that contains a motion."""

    centre: np.ndarray  # (3,) metres, world
    up: np.ndarray  # (3,) unit
    front: np.ndarray  # (3,) unit, level: where the person faces in the first frame
    radius: float  # metres
    height: float  # metres


@torch.no_grad()
def cylinder(rig: Rig, motion: Pose) -> UprightCylinder:
    """Measure the cylinder around a motion."""
    maps = joint_transforms(motion.rotations, rig.joints, rig.parents, motion.transl)
    sampled = slice(None, None, _VERTEX_STRIDE)
    points = skin_points(rig.vertices[sampled], rig.weights[sampled], maps).double().numpy()
    root = maps[:, 0, :3, :3].double().numpy()  # columns: to the left, up, ahead
    up = root[:, :, 1].mean(0)
    if np.linalg.norm(up) < 0.1:  # somersaults have no mean: take the first frame's
        up = root[0, :, 1]
    up = up / np.linalg.norm(up)
    left, _, ahead = root[0].T
    if abs(up @ ahead) > 0.99:  # looking straight up or down
        ahead = np.cross(left, up)
    front = ahead - up * (up @ ahead)
    front /= np.linalg.norm(front)
    axes = np.stack([np.cross(up, front), up, front])
    seen = (points @ axes.T).reshape(-1, 3)
    low, high = seen.min(0), seen.max(0)
    middle = (low + high) / 2
    radius = float(np.linalg.norm((seen - middle)[:, [0, 2]], axis=1).max())
    return UprightCylinder(middle @ axes, up, front, radius, float(high[1] - low[1]))


WHITE = (1.0, 1.0, 1.0)


@torch.no_grad()
def render_frame(
    avatar: Avatar, pose: Pose, camera: Camera, background: tuple[float, float, float] = WHITE
) -> np.ndarray:
    """Render an avatar in a pose of one frame on a colour: 8-bit (H, W, 3)."""
    image = render(avatar(pose), camera, AVATAR_SPLATTING, torch.tensor(background))
    return in_8_bits(image.color.numpy())


@torch.no_grad()
def render_layer(avatar: Avatar, pose: Pose, camera: Camera) -> np.ndarray:
    """Render an avatar without background: (H, W, 4) float32, colour times alpha, and alpha."""
    return layer_of(avatar(pose), camera)


@torch.no_grad()
def layer_of(gaussians: Gaussians, camera: Camera) -> np.ndarray:
    """Render Gaussians in the world without background, as :func:`render_layer` does."""
    image = render(gaussians, camera, AVATAR_SPLATTING)
    return np.concatenate([image.color.numpy(), image.alpha.numpy()[..., None]], axis=2)


def render_shots(
    avatar: Avatar, motion: Pose, shots: Sequence[CameraShot], progress: Progress | None = None
) -> Iterator[np.ndarray]:
    """Yield :func:`render_layer` of each shot, with the avatar driven by a motion."""
    for done, shot in enumerate(shots, 1):
        yield render_layer(avatar, motion[shot.frame], shot.camera)
        if progress:
            progress(done, len(shots))


def over(layer: np.ndarray, background: np.ndarray) -> np.ndarray:
    """Composite a layer (H, W, 4) on a colour (3,) or a picture (H, W, 3): 8-bit (H, W, 3)."""
    return in_8_bits(layer[..., :3] + (1 - layer[..., 3:]) * background)


def to_rgba(layer: np.ndarray) -> np.ndarray:
    """Convert a layer (H, W, 4) to 8-bit RGBA, with colours not multiplied by alpha."""
    color, alpha = layer[..., :3], layer[..., 3:]
    return in_8_bits(np.concatenate([color / np.maximum(alpha, 1e-6), alpha], axis=2))


def cut_out(frame: Frame, background: tuple[float, float, float] = WHITE) -> np.ndarray:
    """Return the target of a frame: the person on a plain background, 8-bit (H, W, 3)."""
    return in_8_bits(frame.on_background(np.array(background, dtype=np.float32)))
