"""Renders of an avatar as 8-bit pictures, and the pictures that they are compared with."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import torch

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.pose import Pose
from gva_mi.data.video import Frame
from gva_mi.splat import Camera, SplatOptions, render

WHITE, BLACK = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)


def render_sequence(
    avatar: Avatar,
    pose: Pose,
    cameras: Sequence[Camera],
    background: tuple[float, float, float] = WHITE,
    options: SplatOptions | None = None,
) -> Iterator[np.ndarray]:
    """The avatar driven by a motion: one 8-bit image (H, W, 3) per frame.

    Args:
        avatar: the avatar.
        pose: the motion, T frames.
        cameras: T of them, or one for all.
        background: linear colour in [0, 1].
        options: of the splatting.

    Raises:
        ValueError: for a number of cameras that is neither 1 nor T.
    """
    if len(cameras) not in (1, len(pose)):
        raise ValueError(
            f"render_sequence(): {len(pose)} poses need as many cameras or one, got {len(cameras)}"
        )
    for k in range(len(pose)):
        yield render_frame(avatar, pose[k], cameras[k % len(cameras)], background, options)


@torch.no_grad()
def render_frame(
    avatar: Avatar,
    pose: Pose,
    camera: Camera,
    background: tuple[float, float, float] = WHITE,
    options: SplatOptions | None = None,
) -> np.ndarray:
    """The avatar in one pose (of one frame), seen by one camera: 8-bit (H, W, 3)."""
    image = render(avatar(pose), camera, options or SplatOptions(), torch.tensor(background))
    return to_8bit(image.color.numpy())


def cut_out(frame: Frame, background: tuple[float, float, float] = WHITE) -> np.ndarray:
    """The target of a frame: the person on a plain background, 8-bit (H, W, 3)."""
    return to_8bit(frame.on_background(np.array(background, dtype=np.float32)))


def to_8bit(image: np.ndarray) -> np.ndarray:
    """Clamp to [0, 1] and round to 256 levels."""
    return np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)
