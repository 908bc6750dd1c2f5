"""Hoods as level sets like the clothes (see ``level_sets``).

over the head  f = smax( |d − stand-off| − thickness, opening of the face, below the collar )
on the back    f = smin over a horseshoe around the nape of ( distance − radius )
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gva_mi.data.synthetic.clothes.level_sets import (
    BodySurface,
    ClosedMesh,
    VoxelGrid,
    smax,
    smin,
    surface_of,
)

CELL = 0.005  # m, grid of hoods
THICK = 0.007  # m, half the thickness of the cloth


def hood_up(surface: BodySurface, joints: Mapping[str, np.ndarray], stand_off: float) -> ClosedMesh:
    """A hood over the head, open in front of the face.

    Args:
        surface: the body.
        joints: rest positions by name.
        stand_off: how far it lies off the skull, metres: beyond the hair below it.
    """
    eyes = (joints["left_eye_smplhf"] + joints["right_eye_smplhf"]) / 2
    neck, head = joints["neck"], joints["head"]
    skull = surface.points[surface.points[:, 1] > head[1]]
    lo, hi = skull.min(0) - 0.08, skull.max(0) + 0.08
    lo[1] = neck[1] - 0.06
    grid = VoxelGrid.around(lo, hi, CELL)
    d = surface.sample(grid, band=0.09)
    x, y, z = grid.x - eyes[0], grid.y - eyes[1], grid.z - eyes[2]
    # It hangs straight from the skull to the collar, farther off at the back of the neck.
    below = np.clip(-y / (eyes[1] - neck[1]), 0, 1)
    shell = np.abs(d - stand_off - 0.02 * below * np.ones_like(d)) - THICK
    # The opening leans forward at the top and closes below the chin.
    ahead = z + 0.035 + 0.10 * y
    face = np.sqrt((x / 0.075) ** 2 + ((y + 0.03) / 0.115) ** 2) - 1
    opening = np.minimum(ahead, -0.09 * face + 0 * z)
    collar = (neck[1] - 0.035) - grid.y
    return surface_of(grid, smax(smax(shell, opening, 0.008), collar + 0 * d, 0.008), None)


def hood_down(
    surface: BodySurface, joints: Mapping[str, np.ndarray], stand_off: float
) -> ClosedMesh:
    """A hood that lies on the back of the shoulders, around the nape.

    Args:
        surface: the body.
        joints: rest positions by name.
        stand_off: how far the shirt below it stands off, metres.
    """
    neck, shoulder = joints["neck"], joints["left_shoulder"]
    wide = 0.52 * shoulder[0]
    nape = surface.points[np.abs(surface.points[:, 1] - neck[1]) < 0.02]
    back = nape[np.abs(nape[:, 0]) < 0.05][:, 2].min() - stand_off - 0.015
    lo = [-wide - 0.10, neck[1] - 0.16, back - 0.14]
    grid = VoxelGrid.around(lo, [wide + 0.10, neck[1] + 0.11, neck[2] + 0.12], CELL)
    field = np.full(grid.shape, 1.0, np.float32)
    for angle in np.linspace(-0.62 * np.pi, 0.62 * np.pi, 25):  # 0 is the middle of the back
        at = np.array([wide * np.sin(angle), neck[1] + 0.03, neck[2] + 0.01])
        at[2] -= (neck[2] - back) * np.cos(angle)
        at[1] -= 0.045 * max(np.cos(angle), 0)  # its weight pulls it down the back
        radius = 0.022 + 0.038 * max(np.cos(angle), 0) ** 2
        away = np.sqrt((grid.x - at[0]) ** 2 + (grid.y - at[1]) ** 2 + (grid.z - at[2]) ** 2)
        field = smin(field, away - radius, 0.02)
    return surface_of(grid, field, None)
