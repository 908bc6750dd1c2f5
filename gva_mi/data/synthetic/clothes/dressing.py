"""Dresses a body: which clothes, hair and accessories it wears, and how they hang on it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gva_mi.data.synthetic.clothes import accessories, bags, binding, garments, hoods
from gva_mi.data.synthetic.clothes.garments import CLOTH_CELL
from gva_mi.data.synthetic.clothes.hair import hair_mesh
from gva_mi.data.synthetic.clothes.level_sets import (
    BAND,
    BodySurface,
    ClosedMesh,
    VoxelGrid,
    smoothstep,
    vertex_normals,
)
from gva_mi.data.synthetic.people import Outfit
from gva_mi.data.synthetic.rest_body import RestBody
from gva_mi.data.synthetic.texture import Material, SkirtCone

if TYPE_CHECKING:
    from scipy.sparse import csr_array


@dataclass(frozen=True)
class Piece:
    """A garment, hair or an accessory, and how it hangs on the body."""

    material: Material
    mesh: ClosedMesh
    binding: csr_array  # (V, vertices of the body), rows sum to 1
    slack: np.ndarray | float = 0.0  # (V,) metres, how far it may lag behind
    crease: float = 0.0  # m, height of its creases


@dataclass(frozen=True)
class Worn:
    """All that a person wears, hair included."""

    pieces: tuple[Piece, ...]
    cone: SkirtCone | None = None  # of a skirt

    @property
    def cloth(self) -> list[ClosedMesh]:
        """What hides the skin below it: clothes and shoes."""
        open_ = (Material.HAIR, Material.ACCESSORY)
        return [piece.mesh for piece in self.pieces if piece.material not in open_]


def dress(
    rest: RestBody, outfit: Outfit, rng: np.random.Generator, clothes: bool, hair: bool
) -> Worn:
    """Everything a person wears.

    Args:
        rest: the body.
        outfit: the cut of clothes and hair.
        rng: for folds, pleats and locks.
        clothes: with clothes, shoes and accessories.
        hair: with hair.
    """
    pieces: list[Piece] = []
    cone = None
    if clothes:
        pieces, cone = _clothes(rest, outfit, rng)
    if hair:
        pieces.append(_hair(rest, outfit, rng, pieces))
    if clothes:
        pieces += [*_hood(rest, outfit), *_bag(rest, outfit), *_accessories(rest, outfit)]
    return Worn(tuple(pieces), cone)


def _clothes(
    rest: RestBody, outfit: Outfit, rng: np.random.Generator
) -> tuple[list[Piece], SkirtCone | None]:
    """Top, bottom and shoes, and the cone of a skirt."""
    vertices, joints, loose, cone = rest.vertices, rest.joints, outfit.loose, None
    reach = np.array([0.09, 0.09, 0.22 if outfit.bottom == "skirt" else 0.09])
    grid = VoxelGrid.around(vertices.min(0) - reach, vertices.max(0) + reach, CLOTH_CELL)
    wide = outfit.flare + 0.02 if outfit.bottom != "skirt" else 0.0
    d = rest.surface.sample(grid, max(BAND, wide))
    top = garments.shirt(grid, d, joints, outfit, rng)
    if outfit.bottom == "skirt":
        bottom, cone = garments.skirt(grid, d, joints, outfit, rng)
    else:
        bottom = garments.trousers(grid, d, joints, outfit)
    height = lambda mesh: mesh.vertices[:, 1].astype(np.float64)
    follow = lambda mesh, smooth: binding.follow_nearest(mesh.vertices, vertices, smooth)
    chest, hip = joints["spine3"][1], joints["left_hip"][1]
    low = smoothstep(chest - height(top), 0.0, chest - joints["pelvis"][1] + outfit.hem)
    out = np.abs(top.vertices[:, 0]) - joints["left_shoulder"][0]
    slack = 0.9 * loose * low + 0.35 * loose * smoothstep(out, 0.05, 0.4)
    pieces = [Piece(Material.TOP, top, follow(top, 0.025), slack, 0.15 * loose + 0.002)]
    drop = smoothstep(hip - height(bottom), 0.02, 0.4)
    if cone is not None:
        hangs = binding.hang_from_hips(bottom.vertices, vertices, joints, rest.weights)
        pieces.append(Piece(Material.BOTTOM, bottom, hangs, 0.035 * drop))
    else:
        hangs = follow(bottom, 0.025)
        pieces.append(Piece(Material.BOTTOM, bottom, hangs, 0.4 * loose * drop, 0.004))
    for side in ("left", "right"):
        shoe = garments.shoe(rest.surface, joints, side, 0.008, outfit.sole)
        pieces.append(Piece(Material.SHOES, shoe, follow(shoe, 0.02)))
    return pieces, cone


def _hair(
    rest: RestBody, outfit: Outfit, rng: np.random.Generator, clothes: Sequence[Piece]
) -> Piece:
    """The hair; long hair falls over the shirt."""
    shirts = [piece.mesh for piece in clothes if piece.material is Material.TOP]
    worn = [BodySurface(m.vertices, m.faces, vertex_normals(m.vertices, m.faces)) for m in shirts]
    mesh = hair_mesh(rest.surface, rest.joints, outfit, rng, *worn)
    below = rest.joints["head"][1] + 0.06 - mesh.vertices[:, 1].astype(np.float64)
    free = smoothstep(below, 0.0, 0.12)
    if outfit.hair == "long":  # what lies on the shoulders does not swing
        free = free * (1 - smoothstep(below, 0.12, 0.2))
    slack = {"short": 0.0, "bob": 0.014, "long": 0.012}[outfit.hair] * free
    hangs = binding.follow_nearest(mesh.vertices, rest.vertices, 0.03)
    return Piece(Material.HAIR, mesh, hangs, slack)


def _accessories(rest: RestBody, outfit: Outfit) -> list[Piece]:
    """Glasses and a cap, if they belong to the outfit."""
    meshes = []
    if outfit.glasses:
        meshes.append(accessories.glasses(rest.surface, rest.joints))
    if outfit.cap:
        stand_off = 1.35 * outfit.hair_thick + 0.004
        meshes.append(accessories.cap(rest.surface, rest.joints, stand_off))
    hangs = lambda mesh: binding.follow_joint(mesh.vertices, rest.weights, "head")
    return [Piece(Material.ACCESSORY, mesh, hangs(mesh)) for mesh in meshes]


def _hood(rest: RestBody, outfit: Outfit) -> list[Piece]:
    """A hood in the colours of the top, if it belongs to the outfit."""
    if outfit.hood == "none":
        return []
    if outfit.hood == "up":
        mesh = hoods.hood_up(rest.surface, rest.joints, outfit.hair_thick + 0.012)
    else:
        mesh = hoods.hood_down(rest.surface, rest.joints, outfit.loose + 0.012)
    return [Piece(Material.TOP, mesh, binding.follow_nearest(mesh.vertices, rest.vertices, 0.03))]


def _bag(rest: RestBody, outfit: Outfit) -> list[Piece]:
    """A bag that goes with the trunk, and its strap over the shirt, if the outfit has one."""
    if outfit.bag == "none":
        return []
    make = bags.backpack if outfit.bag == "backpack" else bags.shoulder_bag
    bag, strap, joint = make(rest.surface, rest.joints, outfit.loose)
    stiff = binding.follow_joint(bag.vertices, rest.weights, joint)
    soft = binding.follow_nearest(strap.vertices, rest.vertices, 0.025)
    return [Piece(Material.ACCESSORY, bag, stiff), Piece(Material.ACCESSORY, strap, soft)]


def covered(vertices: np.ndarray, cloth: Sequence[ClosedMesh]) -> np.ndarray:
    """Which vertices (V, 3) of the body lie under cloth, (V,) bool.

    Those do that have the cloth close by along its own normal, on its outer side.
    """
    from scipy.spatial import cKDTree

    found = np.zeros(len(vertices), dtype=bool)
    for mesh in cloth:
        lit = mesh.shade > 0.98
        normals = vertex_normals(mesh.vertices.astype(np.float64), mesh.faces)[lit]
        tree = cKDTree(mesh.vertices[lit])
        _, index = tree.query(vertices)
        away = vertices - mesh.vertices[lit][index]
        height = np.einsum("vc,vc->v", away, normals[index])
        aside = np.linalg.norm(away - height[:, None] * normals[index], axis=1)
        found |= (height < -0.004) & (height > -0.08) & (aside < 0.008)
    return found
