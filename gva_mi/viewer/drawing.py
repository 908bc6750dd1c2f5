"""Draw the picture of a viewer's state and camera, for browsers and snapshots.

Gaussians are drawn with the same bits as by ``gva-mi render``. What does not change from picture to
picture, above all the posed avatar, is cached.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any

import numpy as np
import torch

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.pose import Pose
from gva_mi.data.pictures import in_8_bits
from gva_mi.data.video import Video
from gva_mi.fit.renders import layer_of, over
from gva_mi.splat import Camera, Gaussians
from gva_mi.viewer.cameras import inscribed
from gva_mi.viewer.state import State, posed
from gva_mi.viewer.surface import PosedSurface, SurfaceRenderer, draw_skeleton, posed_surface

FAINT = 0.25  # of the avatar behind its skeleton


class Drawing:
    """Draw one avatar, driven by a motion of T frames, beside the T frames of a video."""

    def __init__(self, avatar: Avatar, motion: Pose, video: Video | None = None) -> None:
        self._avatar, self.motion, self._video = avatar, motion, video
        self._surfaces: SurfaceRenderer | None = None  # made with Mitsuba, on first use
        self._kept: dict[str, tuple[Hashable, Any]] = {}

    def picture(self, state: State, camera: Camera, fine: bool = True) -> np.ndarray:
        """Draw the avatar over the background, 8-bit (H, W, 3)."""
        return flattened(self.layer(state, camera, fine), state.background)

    def layer(self, state: State, camera: Camera, fine: bool = True) -> np.ndarray:
        """Draw the avatar alone: (H, W, 4) float32, premultiplied colour and alpha.

        A mesh has all its triangles and smooth edges if it is ``fine``.
        """
        if state.mode == "Gaussians":
            return layer_of(self._gaussians(state), camera)
        surface = self._surface(state)
        if state.mode == "skeleton":
            bones = draw_skeleton(
                surface.joints, self._avatar.rig.parents, camera, state.joint, fine
            )
            layer = layer_of(self._gaussians(state), camera)
            layer *= FAINT * (1 - bones[..., 3:])
            layer += bones
            return layer
        if self._surfaces is None:
            self._surfaces = SurfaceRenderer(self._avatar.rig)
        return self._surfaces.layer(state.mode, surface, camera, fine)

    def frame(self, state: State, width: int, height: int) -> np.ndarray:
        """Return the frame of the video centred in a picture, 8-bit (height, width, 3)."""
        from PIL import Image

        def centred() -> np.ndarray:
            image = in_8_bits(self._video[state.frame].image)
            size = inscribed(image.shape[1], image.shape[0], width, height)
            canvas = np.full((height, width, 3), state.background, dtype=np.uint8)
            left, top = (width - size[0]) // 2, (height - size[1]) // 2
            canvas[top : top + size[1], left : left + size[0]] = Image.fromarray(image).resize(size)
            return canvas

        return self._keep("frame", (state.frame, state.background, width, height), centred)

    @torch.no_grad()
    def _gaussians(self, state: State) -> Gaussians:
        make = lambda: self._avatar(posed(self.motion, state))
        return self._keep("gaussians", _pose_key(state), make)

    def _surface(self, state: State) -> PosedSurface:
        make = lambda: posed_surface(self._avatar, posed(self.motion, state))
        return self._keep("surface", _pose_key(state), make)

    def _keep(self, name: str, key: Hashable, make: Callable[[], Any]) -> Any:  # noqa: ANN401
        """Return the cached value if its key is the same; else make a new one."""
        if name not in self._kept or self._kept[name][0] != key:
            self._kept[name] = key, make()
        return self._kept[name][1]


def flattened(layer: np.ndarray, background: tuple[int, int, int]) -> np.ndarray:
    """Composite a layer (H, W, 4) over an 8-bit colour as :func:`over` does: 8-bit (H, W, 3).

    Only the box around the avatar is computed; the rest is background.
    """
    picture = np.full((*layer.shape[:2], 3), background, dtype=np.uint8)
    there = layer[..., 3] > 0
    rows, columns = (np.flatnonzero(there.any(axis)) for axis in (1, 0))
    if len(rows):
        part = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
        picture[part] = over(layer[part], np.array(background, dtype=np.float32) / 255)
    return picture


def _pose_key(state: State) -> Hashable:
    """Return the part of a state that the pose depends on."""
    return state.frame, state.turned, state.expression
