"""Glasses and a cap, as level sets like the clothes (see ``level_sets``); both move with the head.

glasses  f = min( |ring(x, y), z| , capsules of bridge and temples ) - radius
cap      f = smin( smax(d - thickness, band), brim )
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

WIRE_CELL = 0.0013  # m, grid of the glasses
CAP_CELL = 0.0035  # m, grid of the cap
WIRE = 0.0023  # m, radius of the glasses' frame


def glasses(surface: BodySurface, joints: Mapping[str, np.ndarray]) -> ClosedMesh:
    """The frame of a pair of glasses, without lenses.

    Args:
        surface: the body.
        joints: rest positions by name.
    """
    eyes = np.stack([joints["left_eye_smplhf"], joints["right_eye_smplhf"]])
    middle, unit = eyes.mean(0), float(np.linalg.norm(eyes[0] - eyes[1]))
    points = surface.points - middle
    lens = np.array([0.40, 0.31]) * unit  # half width and height
    front = points[(np.abs(points[:, 1]) < lens[1]) & (np.abs(points[:, 0]) > 0.25 * unit)]
    plane = front[np.abs(front[:, 0]) < 0.8 * unit][:, 2].max() + 0.004  # clears the lids
    level = 0.10 * unit  # temples leave the frame a little above the eyes
    head = points[np.abs(points[:, 1] - level) < 0.01]
    ear = np.median(head[:, 2])  # halfway along the head
    width = np.abs(head[np.abs(head[:, 2] - ear) < 0.02][:, 0]).max() + 0.002
    outer = 0.5 * unit + lens[0]

    lo = middle + [-width - 0.01, -0.05, ear - 0.04]
    grid = VoxelGrid.around(lo, middle + [width + 0.01, 0.04, plane + 0.01], WIRE_CELL)
    x, y, z = grid.x - middle[0], grid.y - middle[1], grid.z - middle[2]
    side = np.abs(x)  # both halves at once
    corner = 0.45 * lens[1]
    u = np.maximum(np.abs(side - 0.5 * unit) - lens[0] + corner, 0)
    v = np.maximum(np.abs(y + 0.04 * unit) - lens[1] + corner, 0)
    distance = np.hypot(np.sqrt(u * u + v * v) - corner, z - plane)
    path = [
        (outer, level, plane),
        (max(width, outer + 0.002), level, plane - 0.02),
        (width, level, ear),
        (width - 0.002, level - 0.022, ear - 0.018),
    ]
    for a, b in zip(path[:-1], path[1:], strict=True):
        distance = np.minimum(distance, _segment((side, y, z), np.array(a), np.array(b)))
    inner = 0.5 * unit - lens[0]
    bridge = _segment(
        (side, y, z), np.array([0.0, 0.08 * unit, plane]), np.array([inner, 0.04 * unit, plane])
    )
    return surface_of(grid, np.minimum(distance, bridge) - WIRE, None)


def cap(surface: BodySurface, joints: Mapping[str, np.ndarray], stand_off: float) -> ClosedMesh:
    """A cap with a brim.

    Args:
        surface: the body.
        joints: rest positions by name.
        stand_off: how far it lies off the skull, metres: beyond the hair below it.
    """
    eyes = (joints["left_eye_smplhf"] + joints["right_eye_smplhf"]) / 2
    skull = surface.points[surface.points[:, 1] > eyes[1] + 0.02]
    middle, top = (skull.max(0) + skull.min(0)) / 2, skull[:, 1].max()
    half = np.ptp(skull, axis=0) / 2
    brow = eyes[1] + 0.42 * (top - eyes[1])  # where the brim meets the forehead
    reach = np.array([half[0] + 0.05, 0, 0])
    lo = [middle[0] - reach[0], eyes[1] - 0.02, middle[2] - half[2] - 0.05]
    hi = [middle[0] + reach[0], top + 0.06, middle[2] + half[2] + 0.13]
    grid = VoxelGrid.around(lo, hi, CAP_CELL)
    d = surface.sample(grid)
    x, y, z = grid.x - middle[0], grid.y, grid.z - middle[2]
    line = brow - 0.10 * (half[2] - z)  # lower at the nape
    crown = smax(d - stand_off, line - y + 0 * d, 0.006)

    across, along = half[0] + 0.006, 0.085
    start = half[2] - 0.02
    outline = np.sqrt((x / across) ** 2 + (np.maximum(z - start, 0) / along) ** 2)
    outline = (outline - 1) * across
    height = brow + 0.004 - 0.14 * (z - start) - 2.2 * x**2  # slopes down, curved sideways
    brim = smax(outline + 0 * d, np.abs(y - height) - 0.0035, 0.003)
    brim = smax(brim, start - z + 0 * d, 0.003)
    return surface_of(grid, smin(crown, brim, 0.006), None)


def _segment(x: tuple[np.ndarray, ...], a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Distance of points to the segment from ``a`` to ``b``."""
    along = b - a
    t = sum((x[k] - a[k]) * along[k] for k in range(3)) / (along @ along)
    t = np.clip(t, 0, 1)
    return np.sqrt(sum((x[k] - a[k] - t * along[k]) ** 2 for k in range(3)))
