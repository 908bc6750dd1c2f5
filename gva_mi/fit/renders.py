"""Renders of an avatar as 8-bit pictures, and the pictures they are compared with."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import torch

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.pose import Pose
from gva_mi.core.console import Progress
from gva_mi.data.pictures import in_8_bits
from gva_mi.data.video import Frame
from gva_mi.fit.camera_paths import CameraShot
from gva_mi.splat import Camera, Gaussians, SplatOptions, render

# Splat options of all avatars. The area of a pixel has a variance of 1/12; the 0.3 of 3DGS makes
# outlines wider than in pictures.
DRAWN = SplatOptions(blur=0.1, depth=False)
WHITE, BLACK = (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)


@torch.no_grad()
def render_frame(
    avatar: Avatar,
    pose: Pose,
    camera: Camera,
    background: tuple[float, float, float] = WHITE,
) -> np.ndarray:
    """Render an avatar in a pose of one frame on a colour: 8-bit (H, W, 3)."""
    image = render(avatar(pose), camera, DRAWN, torch.tensor(background))
    return in_8_bits(image.color.numpy())


@torch.no_grad()
def render_layer(avatar: Avatar, pose: Pose, camera: Camera) -> np.ndarray:
    """Render an avatar without background: (H, W, 4) float32, colour times alpha, and alpha."""
    return layer_of(avatar(pose), camera)


@torch.no_grad()
def layer_of(gaussians: Gaussians, camera: Camera) -> np.ndarray:
    """Render Gaussians in the world without background, as :func:`render_layer` does."""
    image = render(gaussians, camera, DRAWN)
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
