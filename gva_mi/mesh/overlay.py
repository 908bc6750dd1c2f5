"""Pictures of a mesh over a photograph, with its outline."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.splat import Camera

# RGB in [0, 1], chosen: unlike skin and most clothes.
OUTLINE = (1.0, 0.25, 0.1)  # orange
BODY_COLOR = (0.35, 0.65, 1.0)
CLAY = (0.72, 0.76, 0.80)
MESH_OPACITY = 0.45  # of the shaded mesh over the picture; chosen: both can be recognised
AMBIENT_LIGHT = 0.25  # share of the light that does not depend on the normal; chosen by eye


@torch.no_grad()
def overlay(
    image: np.ndarray,
    camera: Camera,
    vertices: Tensor,
    faces: Tensor,
    scene: MeshScene | None = None,
) -> np.ndarray:
    """Draw a mesh, vertices (V, 3) in the world, over a picture that a camera took.

    Pictures are (H, W, 3) float32 in [0, 1]. A caller with many pictures of one mesh passes its
    ``scene``.

    Example:
        >>> from gva_mi.splat import look_at
        >>> faces = torch.tensor([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
        >>> vertices = torch.cat([torch.zeros(1, 3), torch.eye(3)])  # of a tetrahedron
        >>> camera = Camera(24.0, 24.0, 8.0, 8.0, look_at((2, 2, 2), (0, 0, 0)), 16, 16)
        >>> picture = overlay(np.zeros((16, 16, 3), np.float32), camera, vertices, faces)
        >>> picture[8, 8].round(2), picture[0, 0]  # the mesh, and the black picture beside it
        (array([0.16, 0.29, 0.45], dtype=float32), array([0., 0., 0.], dtype=float32))
    """
    scene = scene or MeshScene(faces, vertices)
    normals_mask = scene.render(vertices, camera).numpy()
    mask = normals_mask[..., 3:] > 0.5
    light = np.clip(-normals_mask[..., 2:3], 0, 1)  # as by a lamp on the camera
    shaded = np.array(BODY_COLOR) * (AMBIENT_LIGHT + (1 - AMBIENT_LIGHT) * light)
    picture = np.where(mask, (1 - MESH_OPACITY) * image + MESH_OPACITY * shaded, image)
    return outlined(picture, mask[..., 0], OUTLINE)


def outlined(image: np.ndarray, mask: np.ndarray, color: tuple[float, ...]) -> np.ndarray:
    """Draw the outline of a mask (H, W) bool on a picture (H, W, 3); float32.

    The outline is inside the mask: its pixels with one of their four neighbours outside.

    Example:
        >>> mask = np.zeros((5, 5), bool)
        >>> mask[1:4, 1:4] = True
        >>> outlined(np.zeros((5, 5, 3)), mask, (1, 0, 0))[..., 0]
        array([[0., 0., 0., 0., 0.],
               [0., 1., 1., 1., 0.],
               [0., 1., 0., 1., 0.],
               [0., 1., 1., 1., 0.],
               [0., 0., 0., 0., 0.]], dtype=float32)
    """
    padded = np.pad(mask, 1)
    inner = padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    return np.where((mask & ~inner)[..., None], color, image).astype(np.float32)


def strip(rows: list[list[np.ndarray]], gap: int = 4) -> np.ndarray:
    """Lay out pictures (H, W, 3) of one size in rows on white, with a gap in pixels.

    The result (H', W', 3) has the pictures' type: all are floats in [0, 1], or all 8-bit.

    Example:
        >>> picture = np.zeros((8, 6, 3), np.float32)
        >>> strip([[picture, picture], [picture]]).shape
        (20, 16, 3)
    """
    height, width = rows[0][0].shape[:2]
    columns = max(len(row) for row in rows)
    size = (len(rows) * (height + gap) - gap, columns * (width + gap) - gap, 3)
    eight = rows[0][0].dtype == np.uint8
    canvas = np.full(size, 255 if eight else 1, np.uint8 if eight else np.float32)
    for i, row in enumerate(rows):
        for j, picture in enumerate(row):
            top, left = i * (height + gap), j * (width + gap)
            canvas[top : top + height, left : left + width] = picture
    return canvas
