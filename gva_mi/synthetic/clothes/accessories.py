"""Glasses, caps, hoods, bags and their straps, as level sets (see ``level_sets``).

glasses    f = min( |ring(x, y), z| , capsules of bridge and temples ) - radius
cap        f = smin( smax(d - thickness, band), brim )
hood up    f = smax( |d - stand-off| - thickness, opening of the face, below the collar )
hood down  f = smin over a horseshoe around the nape of ( distance - radius )
bag        f = rounded box
strap      f = smax( |d - stand-off| - thickness, band )

d is the distance from the body. Joints are rest positions by name, metres.
"""

from __future__ import annotations

import numpy as np

from gva_mi.body.pose import SIDES
from gva_mi.synthetic.clothes.level_sets import RestMesh, VoxelGrid, smax, smin, surface_of
from gva_mi.synthetic.rest_body import RestBody

WIRE_CELL, CAP_CELL, HOOD_CELL, BAG_CELL = 0.0013, 0.0035, 0.005, 0.006  # m, grid spacing
WIRE = 0.0023  # m, radius of the glasses' frame
HOOD = 0.007  # m, half the thickness of a hood
STRAP, THIN = 0.022, 0.006  # m, half the width and half the thickness of a strap
PRESSED = 0.012  # m, of a strap off the body, besides 0.8 of the shirt, which it presses down
ROUND = 0.03  # m, radius of a bag's edges

BagParts = tuple[RestMesh, RestMesh, str]  # bag, strap, the joint that the bag follows


def glasses(rest: RestBody) -> RestMesh:
    """Model the frame of a pair of glasses, without lenses."""
    eyes = [rest.joints[f"{side}_eye_smplhf"] for side in SIDES]
    middle, unit = rest.between_eyes, float(np.linalg.norm(eyes[0] - eyes[1]))
    points = rest.surface.points - middle
    lens = np.array([0.40, 0.31]) * unit  # half width and height
    front = points[(np.abs(points[:, 1]) < lens[1]) & (np.abs(points[:, 0]) > 0.25 * unit)]
    plane = front[np.abs(front[:, 0]) < 0.8 * unit][:, 2].max() + 0.004  # clears the lids
    level = 0.10 * unit  # the temples are attached a little above the eyes
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
    bridge = (0.0, 0.08 * unit, plane), (0.5 * unit - lens[0], 0.04 * unit, plane)
    for a, b in (*zip(path[:-1], path[1:], strict=True), bridge):
        distance = np.minimum(distance, _segment((side, y, z), np.array(a), np.array(b)))
    return surface_of(grid, distance - WIRE)


def cap(rest: RestBody, stand_off: float) -> RestMesh:
    """Model a cap with a brim, ``stand_off`` metres off the skull."""
    points, eyes = rest.surface.points, rest.between_eyes
    skull = points[points[:, 1] > eyes[1] + 0.02]
    middle, top = (skull.max(0) + skull.min(0)) / 2, skull[:, 1].max()
    half = np.ptp(skull, axis=0) / 2
    brow = eyes[1] + 0.42 * (top - eyes[1])  # where the brim meets the forehead
    reach = np.array([half[0] + 0.05, 0, 0])
    lo = [middle[0] - reach[0], eyes[1] - 0.02, middle[2] - half[2] - 0.05]
    hi = [middle[0] + reach[0], top + 0.06, middle[2] + half[2] + 0.13]
    grid = VoxelGrid.around(lo, hi, CAP_CELL)
    d = rest.surface.sample(grid)
    x, y, z = grid.x - middle[0], grid.y, grid.z - middle[2]
    line = brow - 0.10 * (half[2] - z)  # lower at the nape
    crown = smax(d - stand_off, line - y, 0.006)

    across, along = half[0] + 0.006, 0.085
    start = half[2] - 0.02
    outline = np.sqrt((x / across) ** 2 + (np.maximum(z - start, 0) / along) ** 2)
    outline = (outline - 1) * across
    height = brow + 0.004 - 0.14 * (z - start) - 2.2 * x**2  # slopes down, curved sideways
    brim = smax(outline, np.abs(y - height) - 0.0035, 0.003)
    brim = smax(brim, start - z, 0.003)
    return surface_of(grid, smin(crown, brim, 0.006))


def hood_up(rest: RestBody, stand_off: float) -> RestMesh:
    """Model a hood over the head, open at the face, ``stand_off`` metres off the skull."""
    points, eyes, neck = rest.surface.points, rest.between_eyes, rest.joints["neck"]
    skull = points[points[:, 1] > rest.joints["head"][1]]
    lo, hi = skull.min(0) - 0.08, skull.max(0) + 0.08
    lo[1] = neck[1] - 0.06
    grid = VoxelGrid.around(lo, hi, HOOD_CELL)
    d = rest.surface.sample(grid, band=0.09)
    x, y, z = grid.x - eyes[0], grid.y - eyes[1], grid.z - eyes[2]
    # It hangs straight from the skull to the collar, farther off at the back of the neck.
    below = np.clip(-y / (eyes[1] - neck[1]), 0, 1)
    shell = np.abs(d - stand_off - 0.02 * below) - HOOD
    # The opening leans forward at the top and closes below the chin.
    ahead = z + 0.035 + 0.10 * y
    face = np.sqrt((x / 0.075) ** 2 + ((y + 0.03) / 0.115) ** 2) - 1
    opening = np.minimum(ahead, -0.09 * face)
    collar = (neck[1] - 0.035) - grid.y
    return surface_of(grid, smax(smax(shell, opening, 0.008), collar, 0.008))


def hood_down(rest: RestBody, stand_off: float) -> RestMesh:
    """Model a hood lying on the shoulders, ``stand_off`` metres off the body like the shirt."""
    neck, wide = rest.joints["neck"], 0.52 * rest.joints["left_shoulder"][0]
    points = rest.surface.points
    nape = points[np.abs(points[:, 1] - neck[1]) < 0.02]
    back = nape[np.abs(nape[:, 0]) < 0.05][:, 2].min() - stand_off - 0.015
    lo = [-wide - 0.10, neck[1] - 0.16, back - 0.14]
    grid = VoxelGrid.around(lo, [wide + 0.10, neck[1] + 0.11, neck[2] + 0.12], HOOD_CELL)
    field = np.full(grid.shape, 1.0, np.float32)
    for angle in np.linspace(-0.62 * np.pi, 0.62 * np.pi, 25):  # 0 is the middle of the back
        at = np.array([wide * np.sin(angle), neck[1] + 0.03, neck[2] + 0.01])
        at[2] -= (neck[2] - back) * np.cos(angle)
        at[1] -= 0.045 * max(np.cos(angle), 0)  # its weight pulls it down the back
        radius = 0.022 + 0.038 * max(np.cos(angle), 0) ** 2
        away = np.sqrt((grid.x - at[0]) ** 2 + (grid.y - at[1]) ** 2 + (grid.z - at[2]) ** 2)
        field = smin(field, away - radius, 0.02)
    return surface_of(grid, field)


def backpack(rest: RestBody, loose: float) -> BagParts:
    """Model a backpack and its two straps over a shirt that stands ``loose`` metres off."""
    pelvis, neck, shoulder = (rest.joints[name] for name in ("pelvis", "neck", "left_shoulder"))
    half = np.array([0.80 * shoulder[0], 0.40 * (neck[1] - pelvis[1]), 0.07])
    middle, points = np.array([0.0, neck[1] - 0.04 - half[1], 0.0]), rest.surface.points
    trunk = points[np.abs(points - middle)[:, :2].max(1) < 0.7 * shoulder[0]]
    off = 0.8 * loose + PRESSED
    middle[2] = trunk[:, 2].min() - off + 0.015 - half[2]
    grid = _around_trunk(rest)
    aside = np.abs(np.abs(grid.x) - 0.72 * shoulder[0]) - STRAP
    ends = (pelvis[1] + 0.30 * (neck[1] - pelvis[1])) - grid.y
    return _box(middle, half), _strap(rest, grid, off, smax(aside, ends, 0.004)), "spine3"


def shoulder_bag(rest: RestBody, loose: float) -> BagParts:
    """Model a bag at the left hip whose strap crosses the right shoulder, over the shirt."""
    hip, shoulder, neck = (rest.joints[name] for name in ("left_hip", "right_shoulder", "neck"))
    half, points = np.array([0.045, 0.11, 0.14]), rest.surface.points
    near = np.abs(points[:, 1] - hip[1]) < half[1]
    side = points[near & (np.abs(points[:, 0]) < 2.5 * hip[0])][:, 0].max()
    off = 0.8 * loose + PRESSED
    middle = np.array([side + off + 0.6 * half[0], hip[1] + 0.02, hip[2]])
    grid = _around_trunk(rest)
    # The strap lies in a plane through the bag and the shoulder, parallel to the z axis.
    top = np.array([0.55 * shoulder[0], neck[1], 0.0])
    along = np.array([side + off, middle[1] + 0.3 * half[1], 0.0]) - top  # into the bag
    normal = np.array([-along[1], along[0]]) / np.hypot(along[0], along[1])
    aside = np.abs((grid.x - top[0]) * normal[0] + (grid.y - top[1]) * normal[1]) - STRAP
    band = smax(aside, np.abs(grid.x) - (side + 0.07), 0.004)
    return _box(middle, half), _strap(rest, grid, off, band), "pelvis"


def _strap(rest: RestBody, grid: VoxelGrid, off: float, band: np.ndarray) -> RestMesh:
    d = rest.surface.sample(grid, band=0.08)
    return surface_of(grid, smax(np.abs(d - off) - THIN, band, 0.004))


def _around_trunk(rest: RestBody) -> VoxelGrid:
    """Return a grid around the trunk without the arms, from the hips to the shoulders."""
    low, high = rest.joints["left_hip"][1] - 0.12, rest.joints["neck"][1] + 0.08
    points = rest.surface.points
    inside = points[np.abs(points[:, 0]) < 1.15 * rest.joints["left_shoulder"][0]]
    inside = inside[(inside[:, 1] > low) & (inside[:, 1] < high)]
    lo, hi = inside.min(0) - 0.09, inside.max(0) + 0.09
    lo[1], hi[1] = low, high
    return VoxelGrid.around(lo, hi, BAG_CELL)


def _box(middle: np.ndarray, half: np.ndarray) -> RestMesh:
    """Model a box with rounded edges and half extents ``half`` (3,), metres."""
    grid = VoxelGrid.around(middle - half - 0.02, middle + half + 0.02, BAG_CELL)
    x = [
        np.abs(axis - m) - h + ROUND
        for axis, m, h in zip((grid.x, grid.y, grid.z), middle, half, strict=True)
    ]
    outside = np.sqrt(sum(np.maximum(a, 0) ** 2 for a in x))
    inside = np.minimum(np.maximum(np.maximum(x[0], x[1]), x[2]), 0)
    return surface_of(grid, outside + inside - ROUND)


def _segment(x: tuple[np.ndarray, ...], a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the distance of points to the segment from ``a`` to ``b``."""
    along = b - a
    t = sum((x[k] - a[k]) * along[k] for k in range(3)) / (along @ along)
    t = np.clip(t, 0, 1)
    return np.sqrt(sum((x[k] - a[k] - t * along[k]) ** 2 for k in range(3)))
