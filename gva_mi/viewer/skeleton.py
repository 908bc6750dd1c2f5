"""Draw a skeleton: bones as lines, joints as dots, larger for the body than for fingers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gva_mi.mesh.overlay import BLUE, OUTLINE
from gva_mi.splat import Camera

NEAR = 0.05  # metres in front of the camera; nearer joints are not drawn
BONE = (0.25, 0.27, 0.30)
FINE = 25  # joints from this number on belong to fingers and are drawn thinner
THICK = 400  # picture height / width of a bone, which is at least a pixel
SAMPLES = 2  # per pixel and axis of a fine picture


def draw_skeleton(
    joints: np.ndarray, parents: Sequence[int], camera: Camera, marked: int, fine: bool = True
) -> np.ndarray:
    """Draw joints (J, 3), metres, world, as a layer (H, W, 4) float32: premultiplied colour, alpha.

    The parent of the root is -1. The joint ``marked`` is drawn in orange; lines have smooth edges
    if ``fine``.
    """
    from PIL import Image, ImageDraw

    samples = SAMPLES if fine else 1
    width, height = samples * camera.width, samples * camera.height
    view = camera.resized(width, height)
    depth = joints @ view.T_camera_world[2, :3] + view.T_camera_world[2, 3]
    seen = depth > NEAR
    at = view.project(np.where(seen[:, None], joints, view.position + view.T_camera_world[2, :3]))
    # Lines far outside the picture would be rasterised pixel by pixel.
    seen &= (np.abs(at - (width / 2, height / 2)) < 4 * max(width, height)).all(1)
    picture = Image.new("RGBA", (width, height))
    draw, bone = ImageDraw.Draw(picture), max(1, height // THICK)
    for joint, parent in enumerate(parents):
        if parent >= 0 and seen[joint] and seen[parent]:
            line = [tuple(at[parent]), tuple(at[joint])]
            draw.line(line, _ink(BONE), 2 * bone if joint < FINE else bone)
    for joint in np.argsort(-depth):
        if seen[joint]:
            radius = 2.5 * bone if joint < FINE else 1.3 * bone
            radius *= 1.6 if joint == marked else 1
            ink = _ink(OUTLINE if joint == marked else BLUE)
            (x, y), r = at[joint], radius
            draw.ellipse((x - r, y - r, x + r, y + r), ink)
    picture = picture.convert("RGBa")  # RGBa, with a small a, is premultiplied
    return np.asarray(picture.reduce(samples), dtype=np.float32) / 255


def _ink(color: tuple[float, float, float]) -> tuple[int, int, int, int]:
    return *(round(255 * x) for x in color), 255
