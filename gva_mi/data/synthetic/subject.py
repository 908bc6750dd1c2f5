"""A person made up from one seed: shape, clothes, hair and colours, as one surface that skins."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch

from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.body.skinning import skin_points
from gva_mi.body.smplx import BodyModel
from gva_mi.data.synthetic import garments
from gva_mi.data.synthetic.garments import CLOTH_CELL, BodySurface, Grid, Mesh
from gva_mi.data.synthetic.hair import HairStyle, hair
from gva_mi.data.synthetic.texture import Fabric, Face, Look, Part, Point, linear, palette

if TYPE_CHECKING:
    from scipy.sparse import csr_array

SKINS = [
    linear(*c)
    for c in ((232, 190, 165), (214, 165, 135), (190, 135, 102), (146, 98, 72), (104, 68, 50))
]
HAIRS = [
    linear(*c) for c in ((38, 28, 24), (70, 45, 30), (120, 78, 45), (176, 132, 78), (60, 58, 60))
]
IRISES = [linear(*c) for c in ((70, 45, 30), (75, 105, 125), (85, 105, 70), (50, 35, 28))]
CLOTHS = [
    linear(*c)
    for c in (
        (180, 40, 45), (30, 60, 110), (235, 230, 220), (45, 90, 75), (225, 165, 50), (60, 60, 68),
        (130, 155, 190), (120, 55, 95), (205, 120, 90), (25, 28, 38), (150, 175, 140),
    )
]  # fmt: skip
DENIMS = [linear(*c) for c in ((45, 60, 90), (75, 85, 105), (38, 40, 46), (125, 110, 85))]


@dataclass(frozen=True)
class Wardrobe:
    """What a person wears."""

    sleeve: float  # in (0, 2): 1 the elbow, 2 the wrist
    hem: float  # m, the shirt's end below the pelvis
    loose: float  # m, how far the shirt stands off
    bottom: str  # "trousers", "shorts" or "skirt"
    hair: HairStyle
    hair_thick: float  # m

    @staticmethod
    def draw(rng: np.random.Generator) -> Wardrobe:
        drawn = Wardrobe(
            sleeve=float(rng.choice([rng.uniform(0.45, 0.75), rng.uniform(1.6, 1.9)])),
            hem=float(rng.uniform(0.08, 0.17)),
            loose=float(rng.uniform(0.012, 0.026)),
            bottom=str(rng.choice(["trousers", "trousers", "shorts", "skirt"])),
            hair=str(rng.choice(["bob", "bob", "long", "short"])),
            hair_thick=float(rng.uniform(0.012, 0.02)),
        )
        # A skirt spreads from the hips, and would come through a longer shirt.
        return replace(drawn, hem=0.4 * drawn.hem) if drawn.bottom == "skirt" else drawn


@dataclass(frozen=True)
class Subject:
    """A person's whole outer surface in the rest pose.

    Skin under clothes is left out, so that it cannot come through them.
    """

    vertices: np.ndarray  # (N, 3) float32 metres
    faces: np.ndarray  # (F, 3) int64
    binding: csr_array  # (N, V) rows sum to 1: which vertices of the body a vertex follows
    weights: torch.Tensor  # (N, 55) skinning weights: those of these vertices
    tint: np.ndarray  # (N, 3) float32, multiplies the colour: dark openings, red knuckles
    part: np.ndarray  # (F,) uint32, see Part
    look: Look
    shape: Shape

    def posed(self, body: BodyModel, pose: Pose) -> np.ndarray:
        """The surface in the world, (T, N, 3) float32, metres.

        Skinned like the body. Whatever else moves the body's vertices, such as pose correctives,
        moves what follows them as well.
        """
        posed = body(pose, self.shape)
        rest, points = body.rest(self.shape).vertices, torch.from_numpy(self.vertices)
        frames = []
        for k, T in enumerate(posed.T_world_rest):
            corrected = posed.vertices[k] - skin_points(rest, body.weights, T)
            surface = skin_points(points, self.weights, T).numpy()
            frames.append(surface + self.binding @ corrected.numpy())
        return np.stack(frames).astype(np.float32)


def draw_subject(body: BodyModel, seed: int, clothes: bool = True, hairy: bool = True) -> Subject:
    """The person of a seed.

    Args:
        body: whose shape space and surface are used.
        seed: another seed is another person.
        clothes: dress it; otherwise a swimsuit is painted on the skin.
        hairy: give it hair.
    """
    from scipy.sparse import csr_array, vstack

    rng = np.random.default_rng([seed, 0])
    betas = np.clip(rng.normal(0, 0.7, min(10, body.num_betas)), -1.4, 1.4)
    shape = Shape(torch.tensor(betas, dtype=torch.float32))
    rest = body.rest(shape)
    vertices = rest.vertices.detach().double().numpy()
    faces = body.faces.numpy()
    joints = dict(zip(JOINTS, rest.joints.detach().double().numpy(), strict=True))
    weights = body.weights.detach().double().numpy()
    normals = vertex_normals(vertices, faces)
    wardrobe = Wardrobe.draw(rng)
    look = _draw_look(rng, vertices, weights, joints, swimsuit=not clothes)

    surface = BodySurface(vertices, faces, normals)
    parts: list[tuple[Part, Mesh, float]] = []
    if clothes:
        parts += _dress(surface, vertices, joints, wardrobe, rng)
    if hairy:
        parts.append(
            (Part.HAIR, hair(surface, joints, wardrobe.hair, wardrobe.hair_thick, rng), 0.03)
        )

    covered = _covered(vertices, [mesh for part, mesh, _ in parts if part != Part.HAIR])
    skin = faces[~covered[faces].all(1)]
    used, skin = np.unique(skin, return_inverse=True)
    tint = _skin_tint(vertices, normals, weights, joints)
    skin = skin.reshape(-1, 3)
    of_skin = csr_array(
        (np.ones(len(used)), (np.arange(len(used)), used)), shape=(len(used), len(vertices))
    )
    binding = vstack(
        [of_skin, *(_bind(mesh.vertices, vertices, smooth) for _, mesh, smooth in parts)]
    )
    meshes = [mesh for _, mesh, _ in parts]
    starts = np.cumsum([len(used), *(len(mesh.vertices) for mesh in meshes)])
    return Subject(
        vertices=np.concatenate([vertices[used], *(m.vertices for m in meshes)]).astype(np.float32),
        faces=np.concatenate([skin, *(m.faces + k for m, k in zip(meshes, starts, strict=False))]),
        binding=binding.tocsr(),
        weights=torch.from_numpy(binding @ weights).float(),
        tint=np.concatenate(
            [tint[used], *(np.repeat(m.shade[:, None], 3, axis=1) for m in meshes)]
        ).astype(np.float32),
        part=np.repeat(
            [int(Part.SKIN), *(int(part) for part, _, _ in parts)],
            [len(skin), *(len(m.faces) for m in meshes)],
        ).astype(np.uint32),
        look=look,
        shape=shape,
    )


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals (V, 3), the mean of the adjacent faces' by area."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    normals = np.stack(
        [
            sum(np.bincount(faces[:, k], cross[:, i], len(vertices)) for k in range(3))
            for i in range(3)
        ],
        axis=1,
    )
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)


def _dress(
    surface: BodySurface,
    vertices: np.ndarray,
    joints: Mapping[str, np.ndarray],
    wardrobe: Wardrobe,
    rng: np.random.Generator,
) -> list[tuple[Part, Mesh, float]]:
    """Garments, each with the width in metres over which its weights are smoothed."""
    grid = Grid.around(vertices.min(0) - 0.09, vertices.max(0) + 0.09, CLOTH_CELL)
    d = surface.sample(grid)
    top = garments.shirt(grid, d, joints, wardrobe.loose, wardrobe.sleeve, wardrobe.hem, rng)
    if wardrobe.bottom == "skirt":
        bottom = garments.skirt(grid, d, joints, rng.uniform(0.15, 0.3), rng.uniform(0.7, 1), rng)
    else:
        length = rng.uniform(0.7, 0.9) if wardrobe.bottom == "shorts" else rng.uniform(1.85, 1.95)
        bottom = garments.trousers(grid, d, joints, rng.uniform(0.008, 0.022), length)
    smooth = 0.08 if wardrobe.bottom == "skirt" else 0.025
    shoes = [
        (Part.SHOES, garments.shoe(surface, joints, side, 0.008), 0.02)
        for side in ("left", "right")
    ]
    return [(Part.TOP, top, 0.025), (Part.BOTTOM, bottom, smooth), *shoes]


def _bind(points: np.ndarray, vertices: np.ndarray, smooth: float) -> csr_array:
    """Weights (N, V) of the body's near vertices, blended over ``smooth`` metres."""
    from scipy.sparse import csr_array
    from scipy.spatial import cKDTree

    count = 24
    distance, index = cKDTree(vertices).query(points, k=count, workers=-1)
    near = np.exp(-(distance**2 - distance[:, :1] ** 2) / (2 * smooth**2))
    near /= near.sum(1, keepdims=True)
    rows = np.repeat(np.arange(len(points)), count)
    return csr_array((near.ravel(), (rows, index.ravel())), shape=(len(points), len(vertices)))


def _covered(vertices: np.ndarray, meshes: list[Mesh]) -> np.ndarray:
    """Body vertices (V,) that lie under cloth: the cloth is near along its own normal, outwards."""
    from scipy.spatial import cKDTree

    covered = np.zeros(len(vertices), dtype=bool)
    for mesh in meshes:
        lit = mesh.shade > 0.98
        normals = vertex_normals(mesh.vertices.astype(np.float64), mesh.faces)[lit]
        tree = cKDTree(mesh.vertices[lit])
        _, index = tree.query(vertices)
        away = vertices - mesh.vertices[lit][index]
        height = np.einsum("vc,vc->v", away, normals[index])
        aside = np.linalg.norm(away - height[:, None] * normals[index], axis=1)
        covered |= (height < -0.004) & (height > -0.08) & (aside < 0.008)
    return covered


def _skin_tint(
    vertices: np.ndarray,
    normals: np.ndarray,
    weights: np.ndarray,
    joints: Mapping[str, np.ndarray],
) -> np.ndarray:
    """Redder knuckles, paler palms."""
    tint = np.ones((len(vertices), 3))
    hands = weights[:, 25:].sum(1) + weights[:, 20] + weights[:, 21]
    palm = np.clip(hands, 0, 1) * np.clip(-normals[:, 1], 0, 1)
    tint *= 1 + palm[:, None] * np.array([0.12, 0.10, 0.12])
    for name, joint in joints.items():
        if name.rstrip("123").endswith(("index", "middle", "ring", "pinky", "thumb")):
            near = np.exp(-((vertices - joint) ** 2).sum(1) / (2 * 0.006**2))
            near *= np.clip(normals[:, 1], 0.2, 1)
            tint *= 1 - near[:, None] * np.array([0.06, 0.24, 0.24])
    return tint


def _draw_look(
    rng: np.random.Generator,
    vertices: np.ndarray,
    weights: np.ndarray,
    joints: Mapping[str, np.ndarray],
    swimsuit: bool,
) -> Look:
    skin = palette(rng, SKINS)
    hair_color = palette(rng, HAIRS)
    colors = [CLOTHS[k] for k in rng.permutation(len(CLOTHS))]
    patterns = ["stripes", "plaid", "print", "dots", "plain"]
    top = Fabric(
        str(rng.choice(patterns, p=[0.3, 0.25, 0.25, 0.1, 0.1])),
        (colors[0], colors[1], colors[2]),
        float(rng.uniform(0.05, 0.085)),
    )
    denim = palette(rng, DENIMS)
    bottom = Fabric(
        str(rng.choice(["plain", "plain", "plaid", "dots"])),
        (denim, tuple(1.8 * c for c in denim), colors[3]),
        float(rng.uniform(0.05, 0.08)),
    )
    lips = tuple(s * f for s, f in zip(skin, (0.80, 0.45, 0.45), strict=True))
    return Look(
        skin=skin, lips=lips, iris=palette(rng, IRISES), hair=hair_color,
        brows=tuple(0.5 * c for c in hair_color), top=top, bottom=bottom,
        shoes=palette(rng, CLOTHS), swimsuit=swimsuit, face=_find_face(vertices, joints),
        nails=_find_nails(vertices, weights, joints), shoulder=_point(joints["left_shoulder"]),
        hip=_point(joints["left_hip"]), ground=float(vertices[:, 1].min()),
    )  # fmt: skip


def _find_face(vertices: np.ndarray, joints: Mapping[str, np.ndarray]) -> Face:
    """The mouth lies below the tip of the nose, which is the foremost point under the eyes."""
    eyes = np.stack([joints["left_eye_smplhf"], joints["right_eye_smplhf"]])
    unit, middle = float(np.linalg.norm(eyes[0] - eyes[1])), eyes.mean(0)
    x, y = np.abs(vertices[:, 0] - middle[0]), middle[1] - vertices[:, 1]
    near = vertices[(x < 0.2 * unit) & (y > 0.2 * unit) & (y < 1.1 * unit)]
    nose = near[near[:, 2].argmax()] if len(near) else middle + [0, -0.5 * unit, 0.4 * unit]
    mouth = np.array([middle[0], nose[1] - 0.44 * unit, nose[2] - 0.3 * unit])
    return Face((_point(eyes[0]), _point(eyes[1])), _point(mouth), unit)


def _find_nails(
    vertices: np.ndarray, weights: np.ndarray, joints: Mapping[str, np.ndarray]
) -> tuple[Point, ...]:
    """Nails lie on the back of each finger's end."""
    nails = []
    for side in ("left", "right"):
        for finger in ("index", "middle", "ring", "pinky", "thumb"):
            name = f"{side}_{finger}3"
            end = vertices[weights[:, JOINTS.index(name)] > 0.6]
            if len(end) == 0:
                continue
            along = joints[name] - joints[f"{side}_{finger}2"]
            along = along / np.linalg.norm(along)
            tip = end[(end @ along).argmax()] - 0.006 * along
            near = end[np.linalg.norm(end - tip, axis=1) < 0.012]
            nails.append((tip[0], near[:, 1].max() if len(near) else tip[1], tip[2]))
    return tuple(_point(nail) for nail in nails)


def _point(x: np.ndarray) -> Point:
    return (float(x[0]), float(x[1]), float(x[2]))
