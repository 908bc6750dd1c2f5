"""Shirts, trousers, skirts and shoes as closed surfaces outside the body in its rest pose.

A garment is the zero level set of a field f (negative inside, metres) made from the distance d to
the body:

    cloth    f = smax( drape(d) - looseness(x),  cuts(x) )            hems, sleeves, neckline
    opening  f = smax( f, -hollow )                                   leaves a wall of cloth

Arguments named ``d`` are the body's distance on the ``grid``; ``joints`` are rest positions by
name, metres; ``rng`` draws folds and pleats.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.random import Generator

from gva_mi.synthetic.person.bodies import RestBody
from gva_mi.synthetic.person.identity import Outfit
from gva_mi.synthetic.person.level_sets import (
    RestMesh,
    VoxelGrid,
    smax,
    smin,
    smoothstep,
    surface_of,
)
from gva_mi.synthetic.person.texture import SkirtCone

# All in metres, chosen by eye; cells are a compromise of detail and time.
CLOTH_CELL = 0.0075  # grid of clothes: about two pixels of a 512² picture
SHOE_CELL = 0.005  # grid of shoes
PLEAT_DEPTH = 0.055  # of a skirt's pleats, per metre below the hips
WIDE_FLARE = 0.03  # of trousers, beyond which the legs may touch
LEG_GAP = 0.02  # that is then kept between the legs
CLOTH_THICKNESS = 0.012  # at an opening; more than a cell
SHOE_WELT, SHOE_UPPER = 0.006, 0.008  # how far a shoe's sole and upper stand off the foot

Joints = Mapping[str, np.ndarray]


def _drape(d: np.ndarray, grid: VoxelGrid) -> np.ndarray:
    """Smooth d along the vertical over 5 cm: cloth hangs straight over hollows of the body."""
    from scipy.ndimage import gaussian_filter1d

    return gaussian_filter1d(d, 0.05 / grid.cell, axis=1)


def _with_opening(
    field: np.ndarray,
    uncut: np.ndarray,
    cut: np.ndarray,
    wall: float = CLOTH_THICKNESS,
    depth: float = 0.04,
) -> np.ndarray:
    """Cut a field where ``cut`` > 0, and hollow it out behind the cut, ``depth`` metres inwards.

    A ``wall`` remains, metres; ``uncut`` is the field before any opening was made.
    """
    hollow = np.maximum(uncut + wall, -cut - depth)
    return smax(smax(field, cut), -hollow, 0.004)


def shirt(
    grid: VoxelGrid, d: np.ndarray, joints: Joints, outfit: Outfit, rng: Generator
) -> RestMesh:
    """Model a shirt from ``loose``, ``sleeve`` and ``hem`` of the outfit."""
    sleeve, pelvis, neck = outfit.sleeve, joints["pelvis"], joints["neck"]
    shoulder, elbow, wrist = (joints[f"left_{n}"] for n in ("shoulder", "elbow", "wrist"))
    x, y, z = grid.x, grid.y, grid.z
    trunk = 1 - smoothstep(np.abs(x), 0.75 * shoulder[0], 1.05 * shoulder[0])
    trunk = trunk * (1 - smoothstep(y, shoulder[1] - 0.16, shoulder[1] - 0.06))
    draped = d * (1 - trunk) + trunk * _drape(d, grid)
    uncut = draped - _shirt_stand_off(grid, joints, trunk, outfit, rng)

    start, stop, share = (elbow, wrist, sleeve - 1) if sleeve > 1 else (shoulder, elbow, sleeve)
    end = start[0] + share * (stop[0] - start[0])
    field = _with_opening(uncut, uncut, np.abs(x) - end)
    field = _with_opening(field, uncut, (pelvis[1] - outfit.hem) - y)
    field = smax(field, _neckline(grid, joints), 0.015)
    collar = neck[1] + 0.03 - 0.35 * (z - neck[2])  # higher at the nape
    return surface_of(grid, smax(field, y - collar, 0.015), uncut)


def _shirt_stand_off(
    grid: VoxelGrid, joints: Joints, trunk: np.ndarray, outfit: Outfit, rng: Generator
) -> np.ndarray:
    """Return a shirt's distance from the body, metres: it grows toward hem and cuffs, with folds.

    ``trunk`` is 1 on the trunk and 0 on the arms.
    """
    loose, hem = outfit.loose, outfit.hem
    pelvis, shoulder, wrist = (joints[n] for n in ("pelvis", "left_shoulder", "left_wrist"))
    x, y, z = grid.x, grid.y, grid.z
    drop = smoothstep(shoulder[1] - y, 0.05, shoulder[1] - pelvis[1] + hem)  # 0 at the shoulder
    out = smoothstep(np.abs(x), shoulder[0], wrist[0])
    angle = np.arctan2(z - pelvis[2], x)
    folds = np.zeros(grid.shape, dtype=np.float32)
    for n in (5, 8, 11):
        phase, tilt = rng.uniform(0, 2 * np.pi), rng.uniform(-12, 12)
        folds += np.cos(n * angle + phase + tilt * y) / 3
    cuffs = np.sin(x * rng.uniform(90, 120) + 14 * (z + y)) * smoothstep(out, 0.25, 0.6)
    stand_off = loose * (0.55 + 0.6 * drop * trunk + 0.35 * out) + 0.006
    return stand_off + 0.35 * loose * (folds * drop * trunk + 0.35 * cuffs)


def _neckline(grid: VoxelGrid, joints: Joints) -> np.ndarray:
    """Return a capsule around the neck, lower in front: positive inside, metres."""
    neck, head = joints["neck"], joints["head"]
    low = neck + np.array([0, 0.0, 0.015])
    axis = (head - neck) / np.linalg.norm(head - neck)
    x, y, z = grid.x - low[0], grid.y - low[1], grid.z - low[2]
    t = np.clip(x * axis[0] + y * axis[1] + z * axis[2], -0.01, 1)
    radius = np.sqrt((x - t * axis[0]) ** 2 + (y - t * axis[1]) ** 2 + (z - t * axis[2]) ** 2)
    return 0.40 * np.linalg.norm(joints["left_shoulder"] - neck) - radius


def trousers(grid: VoxelGrid, d: np.ndarray, joints: Joints, outfit: Outfit) -> RestMesh:
    """Model trousers, or shorts if the outfit's ``length`` is below 1; ``flare`` widens the hem."""
    loose, length = outfit.flare, outfit.length
    pelvis = joints["pelvis"]
    hip, knee, ankle = (joints[f"left_{n}"] for n in ("hip", "knee", "ankle"))
    y = grid.y
    below = smoothstep(hip[1] - y, 0.02, 0.25)
    calf = below * np.ones(grid.shape, dtype=np.float32)
    draped = d * (1 - calf) + calf * _drape(d, grid)
    top = pelvis[1] + 0.75 * (joints["spine1"][1] - pelvis[1])
    start, stop, share = (knee, ankle, length - 1) if length > 1 else (hip, knee, length)
    end = start[1] + share * (stop[1] - start[1])
    uncut = draped - (0.009 + loose * smoothstep(hip[1] - y, 0.05, hip[1] - end))
    field = smax(_with_opening(uncut, uncut, end - y), y - top)
    field = smax(field, np.abs(grid.x) - 0.42 * joints["left_elbow"][0] - 0.1)
    if loose > WIDE_FLARE:
        field = smax(field, _between_legs(grid, d), 0.004)
    return surface_of(grid, field, uncut)


def _between_legs(grid: VoxelGrid, d: np.ndarray) -> np.ndarray:
    """Cut a slit below the crotch, where wide trouser legs would merge."""
    middle = int(np.clip(round(-grid.lo[0] / grid.cell), 0, grid.shape[0] - 1))
    crotch = grid.y[0, (d[middle] < 0).any(1), 0].min() - 0.03
    return -np.maximum(np.abs(grid.x) - LEG_GAP / 2, grid.y - crotch)


def skirt(
    grid: VoxelGrid, d: np.ndarray, joints: Joints, outfit: Outfit, rng: Generator
) -> tuple[RestMesh, SkirtCone]:
    """Model a skirt as an elliptic cone with pleats that deepen toward the hem.

    ``flare`` of the outfit is the growth of its radius per metre down.

    Returns:
        the mesh, and the cone without pleats.
    """
    flare, hip, knee = outfit.flare, joints["left_hip"], joints["left_knee"]
    x, y, z = grid.x, grid.y, grid.z
    end = hip[1] + outfit.length * (knee[1] - hip[1])
    top = joints["pelvis"][1] + 0.7 * (joints["spine1"][1] - joints["pelvis"][1])
    half_x, half_z, mid_z = _skirt_ellipse(grid, d, joints, flare, end)
    drop = np.maximum(hip[1] - y, 0)
    angle = np.arctan2(z - mid_z, x)
    pleats = np.cos(13 * angle + rng.uniform(0, 6)) + 0.6 * np.cos(7 * angle + rng.uniform(0, 6))
    grow = (flare + PLEAT_DEPTH * pleats) * drop
    outline = np.sqrt((x / half_x) ** 2 + ((z - mid_z) / half_z) ** 2)
    outline = (outline - 1) * min(half_x, half_z) - grow
    yoke = smax(d - 0.011, (hip[1] - 0.06) - y, 0.03)
    uncut = smin(smax(outline, y - hip[1], 0.03), yoke, 0.05)
    # Pleats make the field steeper than a distance, so the wall is thinner than this number.
    field = smax(_with_opening(uncut, uncut, end - y, 0.022, 0.06), y - top)
    field = smax(field, np.abs(x) - half_x - flare * 0.6)
    slope = flare * (half_x + half_z) / (2 * min(half_x, half_z))  # of the mean radius
    radius = (half_x + half_z) / 2
    apex = (0.0, float(hip[1] + radius / slope), float(mid_z))
    return surface_of(grid, field, uncut), SkirtCone(apex, float(slope), float(half_x / half_z))


def _skirt_ellipse(
    grid: VoxelGrid, d: np.ndarray, joints: Joints, flare: float, end: float
) -> tuple[float, float, float]:
    """Return a skirt's ellipse at the hips, metres: half width, half depth, centre along z.

    It is deep enough to hold the calves down to the height ``end``.
    """
    hip = joints["left_hip"]
    row = lambda height: int(np.clip((height - grid.lo[1]) / grid.cell, 0, grid.shape[1] - 1))
    body = (d < 0) & (np.abs(grid.x) < 0.45 * joints["left_elbow"][0] + 0.1)
    hips = body[:, row(hip[1])]
    half_x = np.abs(grid.x[:, 0, 0])[hips.any(1)].max() + 0.014
    zs = grid.z[0, 0][hips.any(0)]
    half_z, mid_z = np.ptp(zs) / 2 + 0.014, (zs.max() + zs.min()) / 2
    least = flare - 1.6 * PLEAT_DEPTH  # growth where a pleat is deepest
    for level in range(row(end), row(hip[1])):
        out = np.abs(grid.z[0, 0][body[:, level].any(0)] - mid_z).max() + 0.014
        half_z = max(half_z, out - least * (hip[1] - grid.y[0, level, 0]))
    return half_x, half_z, mid_z


def shoe(rest: RestBody, side: str, sole: float) -> RestMesh:
    """Model the "left" or "right" shoe with a flat sole, thickened by ``sole`` metres."""
    ankle, points = rest.joints[f"{side}_ankle"], rest.surface.points
    near = np.linalg.norm(points - rest.joints[f"{side}_foot"], axis=1) < 0.25
    foot = points[near & (np.sign(points[:, 0]) == np.sign(ankle[0]))]
    foot = foot[foot[:, 1] < ankle[1] + 0.06]
    ground = foot[:, 1].min()
    below = np.array([0.04, 0.04 + sole, 0.04])
    grid = VoxelGrid.around(foot.min(0) - below, foot.max(0) + [0.04, 0.03, 0.04], SHOE_CELL)
    d = rest.surface.sample(grid)
    y = grid.y
    sole_top = ground + 0.022
    level = int((sole_top - grid.lo[1]) / grid.cell)
    # Below its top the sole has the outline of the foot at that height.
    d = np.where(y < sole_top, d[:, level : level + 1], d)
    welt = (1 - smoothstep(y, sole_top - 0.006, sole_top + 0.001)) * SHOE_WELT
    uncut = d - SHOE_UPPER - welt
    field = smax(uncut, (ground - 0.014 - sole) - y, 0.008)
    top = ankle[1] + 0.012 + 0.25 * (ankle[2] - grid.z)  # higher at the heel
    return surface_of(grid, _with_opening(field, uncut, y - top, 0.006, 0.02), uncut)
