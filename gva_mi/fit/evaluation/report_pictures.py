"""Pictures of an avatar for its report: turning, beside the truth, face and hands enlarged.

All images are 8-bit (H, W, 3), on white.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import torch

from gva_mi.avatar.avatar import Avatar
from gva_mi.data.video import Frame, Video
from gva_mi.fit.camera_paths import circle
from gva_mi.fit.evaluation.regions import (
    FINGERS,
    HAND,
    box_around,
    close_ups,
    face_box,
    hand_joints,
)
from gva_mi.fit.evaluation.similarity import posed_joints
from gva_mi.fit.renders import cut_out, render_frame, to_8bit
from gva_mi.page import around
from gva_mi.pose.crop import Box
from gva_mi.splat import Camera, Gaussians, look_at, render
from gva_mi.splat.covariances import with_axes

ZOOMED_PIXELS = 220  # about the side of pictures of hands and faces
DOT = 0.0015  # metres, standard deviation of a Gaussian that is drawn as a dot
RED_AT = 64  # levels of 255 at which a difference is shown fully red


def turntable(avatar: Avatar, frame: Frame, count: int) -> Iterator[np.ndarray]:
    """The avatar in a frame's pose, seen by ``count`` cameras on a circle around it.

    The circle begins at the frame's own camera and lies flat in its picture: which way is up in the
    world, a video does not say.
    """
    R = frame.camera.T_camera_world[:3, :3]
    seen = _joints(avatar, frame) @ R.T
    # The middle of their extent along the camera's axes: their mean lies high, most are fingers.
    centre = (seen.min(0) + seen.max(0)) / 2 @ R
    up = -frame.camera.T_camera_world[1, :3]  # y of a camera points down
    toward = frame.camera.position - centre
    toward -= up * (up @ toward)
    width, height = frame.camera.width, frame.camera.height
    lens = (frame.camera.fx, frame.camera.fy, width / 2, height / 2)
    angles = np.linspace(0, 2 * np.pi, count, endpoint=False)
    for T_camera_world in circle(centre, toward, up, 0.1, angles):
        camera = Camera(*lens, T_camera_world, width, height)
        yield render_frame(avatar, frame.pose, camera)


def compared(avatar: Avatar, frame: Frame, difference: bool = True) -> np.ndarray:
    """A frame's picture, the render, and where they differ, side by side, without empty margins."""
    target, image = cut_out(frame), render_frame(avatar, frame.pose, frame.camera)
    parts = [target, image]
    if difference:
        parts.append(_reddened(np.abs(image.astype(int) - target).max(-1)))
    rows, columns = around(target.min(-1) < 250, margin=len(target) // 40)
    return np.concatenate([part[rows, columns] for part in parts], axis=1)


def hands(avatar: Avatar, frame: Frame) -> Iterator[tuple[str, np.ndarray]]:
    """Each hand that lies within the picture: its side, and the picture above the render."""
    joints = _joints(avatar, frame)
    for side in FINGERS:
        box = box_around(frame.camera, hand_joints(joints, side), HAND)
        if box is not None:
            yield side, _zoomed(avatar, frame, box)


def face(avatar: Avatar, frame: Frame) -> np.ndarray | None:
    """The face, the picture above the render; None where it leaves the picture or looks away."""
    box = face_box(frame.camera, _joints(avatar, frame))
    return None if box is None else _zoomed(avatar, frame, box)


def enlarged(avatar: Avatar, frame: Frame) -> Iterator[tuple[str, np.ndarray]]:
    """Head, armpits, hem and hands: the name, and the picture above the render."""
    for name, box in close_ups(frame.camera, _joints(avatar, frame)):
        yield name, _zoomed(avatar, frame, box)


def _zoomed(avatar: Avatar, frame: Frame, box: Box) -> np.ndarray:
    """A box of the picture above the same of the render.

    The picture's pixels are shown as squares; the render is made at the zoomed resolution.
    """
    factor = max(1, round(ZOOMED_PIXELS / box.width))
    seen, enlarged = box.cut(cut_out(frame)), (factor * box.width, factor * box.height)
    image = render_frame(avatar, frame.pose, box.cut_camera(frame.camera).resized(*enlarged))
    return np.concatenate([seen.repeat(factor, 0).repeat(factor, 1), image], axis=0)


def dots(gaussians: Gaussians, height: int = 560) -> np.ndarray:
    """Every Gaussian as a small dot of its own colour, seen from the front and from the side."""
    small = Gaussians(
        gaussians.means,
        gaussians.means.new_zeros(len(gaussians), 4),  # round: turned by nothing
        torch.full_like(gaussians.means, DOT),
        torch.full_like(gaussians.opacities, 0.99),
        sh=gaussians.sh[:, :1],
    )
    points = gaussians.means.numpy()
    low, high = np.quantile(points, 0.001, axis=0), np.quantile(points, 0.999, axis=0)
    centre, size = (low + high) / 2, (high - low) * 1.1
    scale, views = height / size[1], []
    for axis, across in (((0, 0, 1), 0), ((1, 0, 0), 2)):
        distance = 8.0  # far away, for a nearly parallel view
        width = round(size[across] * scale)
        T_camera_world = look_at(centre + distance * np.array(axis), centre)
        focal = distance * scale
        camera = Camera(focal, focal, width / 2, height / 2, T_camera_world, width, height)
        with torch.no_grad():
            views.append(to_8bit(render(small, camera, background=torch.ones(3)).color.numpy()))
    return np.concatenate(views, axis=1)


def same_size(images: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Pictures brought to one size by white margins around them."""
    height, width = (max(image.shape[axis] for image in images) for axis in (0, 1))
    canvases = []
    for image in images:
        top, left = (height - image.shape[0]) // 2, (width - image.shape[1]) // 2
        canvas = np.full((height, width, 3), 255, np.uint8)
        canvas[top : top + image.shape[0], left : left + image.shape[1]] = image
        canvases.append(canvas)
    return canvases


def side_by_side(images: Sequence[np.ndarray], height: int) -> np.ndarray:
    """Pictures of any sizes in a row, each scaled to one height."""
    from PIL import Image

    scaled = []
    for image in images:
        width = max(1, round(image.shape[1] * height / image.shape[0]))
        resized = Image.fromarray(image).resize((width, height), Image.Resampling.LANCZOS)
        scaled.append(np.asarray(resized))
    return np.concatenate(scaled, axis=1)


def overview(avatar: Avatar, video: Video, turned: int = 3) -> np.ndarray:
    """The method in one picture: a frame, its normals, the Gaussians, and new views."""
    frame = video[(video.splits.test or video.splits.train)[0]]
    parts = [cut_out(frame)]
    if frame.normals is not None:
        shown = np.where(frame.mask[..., None] > 0.5, (frame.normals + 1) / 2, 1)
        parts.append(to_8bit(shown))
    with torch.no_grad():
        whole = with_axes(avatar(frame.pose))
        thin = replace(whole, scales=whole.scales / 3)
        image = render(thin, frame.camera, background=torch.ones(3))
    parts.append(to_8bit(image.color.numpy()))
    parts += list(turntable(avatar, frame, turned + 1))[1:]
    margin = len(parts[0]) // 50
    return side_by_side([part[around(part.min(-1) < 250, margin)] for part in parts], 480)


def _joints(avatar: Avatar, frame: Frame) -> np.ndarray:
    """The avatar's joints in a frame's pose, (55, 3) metres, world."""
    return posed_joints(avatar.rig, frame.pose)[0].detach().double().numpy()


def _reddened(difference: np.ndarray) -> np.ndarray:
    """Differences (H, W) in levels of 255: white for none, red for RED_AT and more."""
    share = np.clip(difference / RED_AT, 0, 1)[..., None]
    white, red = np.array([255, 255, 255]), np.array([190, 20, 40])
    return np.round(white * (1 - share) + red * share).astype(np.uint8)
