"""Dress a body: choose clothes and hair, and bind them to it.

Each vertex of a piece follows vertices of the body by sparse weights that sum to 1:

    follow_nearest    weights ~ exp( -distance² / 2 smooth² ), for clothes and hair
    hang_from_hips    a skirt follows the nearest vertices at its waist and both thighs below it:

        thighs   t = THIGH_WEIGHT · smoothstep(distance below the hips)
        left     s = smoothstep(x / half the body's width)
        weights  (1 - t) nearest,  t s of the left thigh's mean,  t (1 - s) of the right one's

With nearest vertices alone, a skirt would tear in two between the legs. A thigh's mean is over the
vertices that its joint moves most. Both functions return (N, V) for N points and V vertices of
the body.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.random import Generator

from gva_mi.body.pose import JOINTS, SIDES
from gva_mi.synthetic.person.bodies import RestBody
from gva_mi.synthetic.person.garments import CLOTH_CELL, shirt, shoe, skirt, trousers
from gva_mi.synthetic.person.hair import hair_mesh
from gva_mi.synthetic.person.identity import Outfit
from gva_mi.synthetic.person.level_sets import (
    EXACT_BAND,
    BodySurface,
    RestMesh,
    VoxelGrid,
    smoothstep,
    vertex_normals,
)
from gva_mi.synthetic.person.texture import Material, SkirtCone

if TYPE_CHECKING:
    from scipy.sparse import csr_array

BOUND_VERTICES = 24  # of the body, that a vertex of a garment follows; chosen: cover ``smooth``
# How a skirt hangs; chosen by eye: it follows both legs, and does not tear between them.
THIGH_VERTICES = 200  # of the body, whose mean represents a thigh
THIGH_WEIGHT = 0.9  # of the thighs at the hem
SKIRT_WAIST = -0.02  # m below the hips where the weight of the thighs begins
SKIRT_SMOOTHING = 0.08  # m, over which nearest vertices are weighted
SKIRT_BLEND = 0.75  # of the hips' half width: beyond it, a skirt follows one thigh alone


@dataclass(frozen=True)
class Piece:
    """A garment or hair, bound to the body."""

    material: Material
    mesh: RestMesh
    binding: csr_array  # (V, vertices of the body), rows sum to 1
    slack: np.ndarray | float = 0.0  # (V,) metres, the most it may lag behind
    crease: float = 0.0  # m, height of its creases


def dress(rest: RestBody, outfit: Outfit, rng: Generator) -> tuple[list[Piece], SkirtCone | None]:
    """Return clothes and hair, and the cone of a skirt; ``rng`` draws folds and locks."""
    pieces, cone = _clothes(rest, outfit, rng)
    return [*pieces, _hair(rest, outfit, rng, pieces[0].mesh)], cone


def _clothes(
    rest: RestBody, outfit: Outfit, rng: Generator
) -> tuple[list[Piece], SkirtCone | None]:
    """Make top, bottom and shoes, in this order; also return the cone of a skirt."""
    vertices, joints, loose, cone = rest.vertices, rest.joints, outfit.loose, None
    reach = np.array([0.09, 0.09, 0.22 if outfit.bottom == "skirt" else 0.09])
    grid = VoxelGrid.around(vertices.min(0) - reach, vertices.max(0) + reach, CLOTH_CELL)
    wide = outfit.flare + 0.02 if outfit.bottom != "skirt" else 0.0
    d = rest.surface.sample(grid, max(EXACT_BAND, wide))
    top = shirt(grid, d, joints, outfit, rng)
    if outfit.bottom == "skirt":
        bottom, cone = skirt(grid, d, joints, outfit, rng)
    else:
        bottom = trousers(grid, d, joints, outfit)
    height = lambda mesh: mesh.vertices[:, 1].astype(np.float64)
    chest, hip = joints["spine3"][1], joints["left_hip"][1]
    low = smoothstep(chest - height(top), 0.0, chest - joints["pelvis"][1] + outfit.hem)
    out = np.abs(top.vertices[:, 0]) - joints["left_shoulder"][0]
    slack = 0.9 * loose * low + 0.35 * loose * smoothstep(out, 0.05, 0.4)
    pieces = [_soft(rest, Material.TOP, top, 0.025, slack, 0.15 * loose + 0.002)]
    drop = smoothstep(hip - height(bottom), 0.02, 0.4)
    if cone is not None:
        hangs = hang_from_hips(bottom.vertices, rest)
        pieces.append(Piece(Material.BOTTOM, bottom, hangs, 0.035 * drop))
    else:
        pieces.append(_soft(rest, Material.BOTTOM, bottom, 0.025, 0.4 * loose * drop, 0.004))
    pieces += [_soft(rest, Material.SHOES, shoe(rest, side, outfit.sole), 0.02) for side in SIDES]
    return pieces, cone


def _hair(rest: RestBody, outfit: Outfit, rng: Generator, top: RestMesh) -> Piece:
    """Make the hair; long hair falls over the shirt."""
    below = BodySurface(top.vertices, top.faces, vertex_normals(top.vertices, top.faces))
    mesh = hair_mesh(rest, outfit, rng, below)
    below = rest.joints["head"][1] + 0.06 - mesh.vertices[:, 1].astype(np.float64)
    free = smoothstep(below, 0.0, 0.12)
    if outfit.hair == "long":  # hair on the shoulders does not swing
        free = free * (1 - smoothstep(below, 0.12, 0.2))
    slack = {"short": 0.0, "bob": 0.014, "long": 0.012}[outfit.hair] * free
    return _soft(rest, Material.HAIR, mesh, 0.03, slack)


def _soft(
    rest: RestBody,
    material: Material,
    mesh: RestMesh,
    smooth: float,
    slack: np.ndarray | float = 0.0,
    crease: float = 0.0,
) -> Piece:
    """Bind a mesh to the nearest vertices of the body, weighted over ``smooth`` metres."""
    bound = follow_nearest(mesh.vertices, rest.vertices, smooth)
    return Piece(material, mesh, bound, slack, crease)


def covered(vertices: np.ndarray, cloth: Sequence[RestMesh]) -> np.ndarray:
    """Return which vertices (V, 3) of the body lie just below cloth, (V,) bool."""
    from scipy.spatial import cKDTree

    hidden = np.zeros(len(vertices), dtype=bool)
    for mesh in cloth:
        lit = mesh.shade > 0.98
        normals = vertex_normals(mesh.vertices.astype(np.float64), mesh.faces)[lit]
        _, index = cKDTree(mesh.vertices[lit]).query(vertices)
        away = vertices - mesh.vertices[lit][index]
        height = np.einsum("vc,vc->v", away, normals[index])
        aside = np.linalg.norm(away - height[:, None] * normals[index], axis=1)
        hidden |= (height < -0.004) & (height > -0.08) & (aside < 0.008)
    return hidden


def follow_nearest(points: np.ndarray, vertices: np.ndarray, smooth: float) -> csr_array:
    """Bind points (N, 3) to the nearest vertices (V, 3), weighted over ``smooth`` metres."""
    from scipy.sparse import csr_array
    from scipy.spatial import cKDTree

    distance, index = cKDTree(vertices).query(points, k=BOUND_VERTICES, workers=-1)
    share = np.exp(-(distance**2 - distance[:, :1] ** 2) / (2 * smooth**2))
    share /= share.sum(1, keepdims=True)
    rows = np.repeat(np.arange(len(points)), BOUND_VERTICES)
    return csr_array((share.ravel(), (rows, index.ravel())), shape=(len(points), len(vertices)))


def hang_from_hips(points: np.ndarray, rest: RestBody) -> csr_array:
    """Bind the points (N, 3) of a skirt to hips and thighs."""
    from scipy.sparse import csr_array, diags_array

    hip, knee = rest.joints["left_hip"], rest.joints["left_knee"]
    middle = rest.joints["pelvis"][0]
    half = 2 * SKIRT_BLEND * abs(hip[0] - middle)
    hem = 0.75 * (hip[1] - knee[1])
    thighs = THIGH_WEIGHT * smoothstep(hip[1] - points[:, 1], SKIRT_WAIST, hem)
    left = smoothstep(points[:, 0] - middle, -half, half)
    shares = np.stack([thighs * left, thighs * (1 - left)], axis=1)
    moved = [rest.weights[:, JOINTS.index(f"{side}_hip")] for side in SIDES]
    groups = [np.argsort(-weights, kind="stable")[:THIGH_VERTICES] for weights in moved]
    equal, at = np.full(2 * THIGH_VERTICES, 1 / THIGH_VERTICES), np.concatenate(groups)
    entries = equal, (np.repeat([0, 1], THIGH_VERTICES), at)
    legs = csr_array(shares) @ csr_array(entries, shape=(2, len(rest.vertices)))
    nearest = follow_nearest(points, rest.vertices, SKIRT_SMOOTHING)
    return (diags_array(1 - thighs) @ nearest + legs).tocsr()
