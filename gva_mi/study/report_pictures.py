"""Pictures of an avatar for its report; all are 8-bit (H, W, 3), on white."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
import torch

from gva_mi.avatar.avatar import Avatar
from gva_mi.data.crop import Box
from gva_mi.data.video import Frame, Video
from gva_mi.fit.camera_paths import circle
from gva_mi.fit.renders import cut_out, render_frame, to_8bit
from gva_mi.splat import Camera, Gaussians, look_at, render
from gva_mi.splat.geometry import with_axes
from gva_mi.study.page import around
from gva_mi.study.regions import FINGERS, close_ups, face_box, hand_box
from gva_mi.study.similarity import posed_joints

ZOOMED_PIXELS = 220  # about the side of an enlarged box
DOT = 0.0015  # metres, standard deviation of a Gaussian drawn as a dot
RED_AT = 64  # levels of 255 at which a difference is fully red


def turntable(avatar: Avatar, frame: Frame, count: int) -> Iterator[np.ndarray]:
    """Render the avatar in a frame's pose from ``count`` cameras on a circle around it.

    The circle begins at the frame's camera and is horizontal in its picture, because a video does
    not say which way is up in the world.
    """
    R = frame.camera.T_camera_world[:3, :3]
    seen = _joints(avatar, frame) @ R.T
    # The centre of the joints' extent along the camera's axes; their mean is biased by the fingers.
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
    """Show picture, render and difference side by side, without empty margins."""
    target, image = cut_out(frame), render_frame(avatar, frame.pose, frame.camera)
    parts = [target, image]
    if difference:
        share = np.abs(image.astype(int) - target).max(-1)[..., None] / RED_AT
        white, red = np.array([255, 255, 255]), np.array([190, 20, 40])
        parts.append(np.round(white + np.minimum(share, 1) * (red - white)).astype(np.uint8))
    rows, columns = around(target.min(-1) < 250, margin=len(target) // 40)
    return np.concatenate([part[rows, columns] for part in parts], axis=1)


def zoomed(avatar: Avatar, frame: Frame, what: str) -> Iterator[tuple[str, np.ndarray]]:
    """Enlarge details that lie in the picture: the name of each, and picture above render.

    The picture's pixels are shown as squares; the render has the enlarged resolution.

    Args:
        avatar: to render.
        frame: the picture.
        what: "face", "hands", or "close-ups" (head, armpits, hem, hands).
    """
    joints, camera, boxes = _joints(avatar, frame), frame.camera, {}
    if what == "face":
        boxes["face"] = face_box(camera, joints)
    elif what == "hands":
        boxes = {side: hand_box(camera, joints, side) for side in FINGERS}
    else:
        boxes = dict(close_ups(camera, joints))
    for name, box in boxes.items():
        if box is not None:
            yield name, _enlarged(avatar, frame, box)


def _enlarged(avatar: Avatar, frame: Frame, box: Box) -> np.ndarray:
    factor = max(1, round(ZOOMED_PIXELS / box.width))
    seen, size = box.cut(cut_out(frame)), (factor * box.width, factor * box.height)
    image = render_frame(avatar, frame.pose, box.cut_camera(frame.camera).resized(*size))
    return np.concatenate([seen.repeat(factor, 0).repeat(factor, 1), image], axis=0)


def dots(gaussians: Gaussians, height: int = 560) -> np.ndarray:
    """Draw every Gaussian as a dot of its own colour, from the front and from the side."""
    small = Gaussians(
        gaussians.means,
        gaussians.means.new_zeros(len(gaussians), 4),  # round, so any rotation will do
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
    """Pad pictures with white to one size."""
    height, width = (max(image.shape[axis] for image in images) for axis in (0, 1))
    padded = []
    for image in images:
        free = height - image.shape[0], width - image.shape[1]
        pads = [(margin // 2, margin - margin // 2) for margin in free]
        padded.append(np.pad(image, [*pads, (0, 0)], constant_values=255))
    return padded


def overview(avatar: Avatar, video: Video, turned: int = 3) -> np.ndarray:
    """Show the method in one picture: a frame, its normals, the Gaussians, and new views."""
    from PIL import Image

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
    scaled, height = [], 480
    for part in parts:
        cut = part[around(part.min(-1) < 250, len(parts[0]) // 50)]
        width = max(1, round(cut.shape[1] * height / cut.shape[0]))
        resized = Image.fromarray(cut).resize((width, height), Image.Resampling.LANCZOS)
        scaled.append(np.asarray(resized))
    return np.concatenate(scaled, axis=1)


def _joints(avatar: Avatar, frame: Frame) -> np.ndarray:
    """Return the avatar's joints in a frame's pose, (55, 3) metres, world."""
    return posed_joints(avatar.rig, frame.pose)[0].detach().double().numpy()
