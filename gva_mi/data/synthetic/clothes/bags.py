"""Bags as level sets like the clothes (see ``level_sets``), each with a strap over the shirt.

bag    f = rounded box
strap  f = smax( |d − stand-off| − thickness, band )     a band of a shell around the trunk

A bag is stiff and goes with one joint of the trunk; its strap follows the shirt below it.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from gva_mi.data.synthetic.clothes.level_sets import (
    BodySurface,
    ClosedMesh,
    VoxelGrid,
    smax,
    surface_of,
)

CELL = 0.006  # m, grid of bags
STRAP, THIN = 0.022, 0.006  # m, half the width and half the thickness of a strap
ROUND = 0.03  # m, radius of a bag's edges

BagParts = tuple[ClosedMesh, ClosedMesh, str]  # the bag, its strap, the joint that the bag follows


def backpack(surface: BodySurface, joints: Mapping[str, np.ndarray], loose: float) -> BagParts:
    """A backpack with two straps over the shoulders.

    Args:
        surface: the body.
        joints: rest positions by name.
        loose: how far the shirt below it stands off, metres.
    """
    pelvis, neck, shoulder = (joints[name] for name in ("pelvis", "neck", "left_shoulder"))
    half = np.array([0.80 * shoulder[0], 0.40 * (neck[1] - pelvis[1]), 0.07])
    middle = np.array([0.0, neck[1] - 0.04 - half[1], 0.0])
    trunk = surface.points[np.abs(surface.points - middle)[:, :2].max(1) < 0.7 * shoulder[0]]
    off = _stand_off(loose)
    middle[2] = trunk[:, 2].min() - off + 0.015 - half[2]
    bag = _box(middle, half)

    grid = _around_trunk(surface, joints)
    d = surface.sample(grid, band=0.08)
    aside = np.abs(np.abs(grid.x) - 0.72 * shoulder[0]) - STRAP
    ends = (pelvis[1] + 0.30 * (neck[1] - pelvis[1])) - grid.y
    band = smax(aside + 0 * grid.y + 0 * grid.z, ends + 0 * d, 0.004)
    strap = surface_of(grid, smax(np.abs(d - off) - THIN, band, 0.004), None)
    return bag, strap, "spine3"


def shoulder_bag(surface: BodySurface, joints: Mapping[str, np.ndarray], loose: float) -> BagParts:
    """A bag at the left hip, with a strap over the right shoulder; arguments as of a backpack."""
    hip, shoulder, neck = (joints[name] for name in ("left_hip", "right_shoulder", "neck"))
    half = np.array([0.045, 0.11, 0.14])
    near = np.abs(surface.points[:, 1] - hip[1]) < half[1]
    side = surface.points[near & (np.abs(surface.points[:, 0]) < 2.5 * hip[0])][:, 0].max()
    off = _stand_off(loose)
    middle = np.array([side + off + 0.6 * half[0], hip[1] + 0.02, hip[2]])
    bag = _box(middle, half)

    grid = _around_trunk(surface, joints)
    d = surface.sample(grid, band=0.08)
    # A plane through the bag and the shoulder, that looks forward and back.
    top = np.array([0.55 * shoulder[0], neck[1], 0.0])
    along = np.array([side + off, middle[1] + 0.3 * half[1], 0.0]) - top  # into the bag
    normal = np.array([-along[1], along[0]]) / np.hypot(along[0], along[1])
    aside = np.abs((grid.x - top[0]) * normal[0] + (grid.y - top[1]) * normal[1]) - STRAP
    trunk = np.abs(grid.x) - (side + 0.07)
    band = smax(aside + 0 * grid.z, trunk + 0 * d, 0.004)
    strap = surface_of(grid, smax(np.abs(d - off) - THIN, band, 0.004), None)
    return bag, strap, "pelvis"


def _stand_off(loose: float) -> float:
    """How far a strap lies off the body, metres: on the shirt, which it presses down a little."""
    return 0.8 * loose + 0.012


def _around_trunk(surface: BodySurface, joints: Mapping[str, np.ndarray]) -> VoxelGrid:
    """A grid of the trunk without arms, from the hips to the shoulders."""
    low, high = joints["left_hip"][1] - 0.12, joints["neck"][1] + 0.08
    wide = 1.15 * joints["left_shoulder"][0]
    inside = surface.points[np.abs(surface.points[:, 0]) < wide]
    inside = inside[(inside[:, 1] > low) & (inside[:, 1] < high)]
    lo, hi = inside.min(0) - 0.09, inside.max(0) + 0.09
    lo[1], hi[1] = low, high
    return VoxelGrid.around(lo, hi, CELL)


def _box(middle: np.ndarray, half: np.ndarray) -> ClosedMesh:
    """A box with rounded edges, half as large as ``half`` (3,) along each axis, metres."""
    grid = VoxelGrid.around(middle - half - 0.02, middle + half + 0.02, CELL)
    x = [
        np.abs(axis - m) - h + ROUND
        for axis, m, h in zip((grid.x, grid.y, grid.z), middle, half, strict=True)
    ]
    outside = np.sqrt(sum(np.maximum(a, 0) ** 2 for a in x))
    inside = np.minimum(np.maximum(np.maximum(x[0], x[1]), x[2]), 0)
    return surface_of(grid, outside + inside - ROUND, None)
