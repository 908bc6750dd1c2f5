"""A person made up from one seed: shape, clothes, hair and colours, as one surface that skins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch

from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.body.skinning import skin_points
from gva_mi.body.smplx import BodyModel
from gva_mi.data.synthetic import accessories, binding, garments
from gva_mi.data.synthetic.folds import Crease, creases, lagging
from gva_mi.data.synthetic.garments import CLOTH_CELL, BodySurface, Grid, Mesh, smoothstep
from gva_mi.data.synthetic.hair import hair
from gva_mi.data.synthetic.people import Person, Wardrobe
from gva_mi.data.synthetic.texture import Cone, Face, Look, Part, Point

if TYPE_CHECKING:
    from scipy.sparse import csr_array


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
    slack: np.ndarray  # (N,) metres: how far loose ends may lag behind
    creases: tuple[Crease, ...]

    def posed(
        self, body: BodyModel, pose: Pose, past: Sequence[Pose] = (), folds: float = 0.0
    ) -> np.ndarray:
        """The surface in the world, (T, N, 3) float32, metres.

        Skinned like the body. Whatever else moves the body's vertices, such as pose correctives,
        moves what follows them as well. Folds and lags come on top, see ``folds``.

        Args:
            body: the body it was drawn on.
            pose: T frames.
            past: poses of T frames each, a step, two steps, ... before these; without them nothing
                lags.
            folds: factor on creases and lags; 0 leaves them out.
        """
        skinned = self._skinned(body, pose, np.arange(len(self.vertices)))
        if folds == 0:
            return skinned
        loose = np.flatnonzero(self.slack > 0) if past else np.zeros(0, int)
        before = [self._skinned(body, p, loose) for p in past] if len(loose) else []
        rotations = pose.rotations.double().numpy()
        for k, surface in enumerate(skinned):
            moved = np.zeros(surface.shape)
            if before:
                now, then = surface[loose], np.stack([b[k] for b in before])
                # Away from the body: unlike normals, the same on both sides of a hem.
                below = self.binding[loose] @ body(pose[k], self.shape).vertices[0].numpy()
                away = now - below
                away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-6)
                moved[loose] += lagging(now, then, folds * self.slack[loose], away)
            normals = vertex_normals(surface.astype(np.float64), self.faces)
            for crease in self.creases:
                height = folds * crease.displacement(rotations[k, crease.joint])
                moved[crease.index] += height[:, None] * normals[crease.index]
            skinned[k] = surface + moved
        return skinned

    def _skinned(self, body: BodyModel, pose: Pose, index: np.ndarray) -> np.ndarray:
        """Some vertices without folds, (T, n, 3) float32."""
        rest, points = body.rest(self.shape).vertices, torch.from_numpy(self.vertices[index])
        weights, binding = self.weights[torch.from_numpy(index)], self.binding[index]
        frames = []
        for k in range(len(pose)):
            posed = body(pose[k], self.shape)
            T = posed.T_world_rest[0]
            corrected = posed.vertices[0] - skin_points(rest, body.weights, T)
            frames.append(skin_points(points, weights, T).numpy() + binding @ corrected.numpy())
        return np.stack(frames).astype(np.float32)

    def thinned(self, every: int) -> Subject:
        """Every n-th vertex of it, without faces: for measures, not for pictures."""
        index = np.arange(0, len(self.vertices), every)
        return replace(
            self, vertices=self.vertices[index], faces=np.zeros((0, 3), np.int64),
            binding=self.binding[index], weights=self.weights[torch.from_numpy(index)],
            tint=self.tint[index], part=np.zeros(0, np.uint32), slack=self.slack[index], creases=(),
        )  # fmt: skip


@dataclass(frozen=True)
class Frame:
    """The body that is dressed, in its rest pose."""

    surface: BodySurface
    vertices: np.ndarray  # (V, 3) metres
    joints: Mapping[str, np.ndarray]  # by name
    weights: np.ndarray  # (V, 55)


@dataclass(frozen=True)
class Piece:
    """A garment, hair or an accessory, and how it hangs on the body."""

    part: Part
    mesh: Mesh
    binding: csr_array  # (V, vertices of the body)
    slack: np.ndarray | float = 0.0  # (V,) metres, how far it may lag
    crease: float = 0.0  # m, height of its creases


def draw_subject(
    body: BodyModel, who: int | Person, clothes: bool = True, hairy: bool = True
) -> Subject:
    """A person's surface.

    Args:
        body: whose shape space and surface are used.
        who: a person, or a seed: another seed is another person.
        clothes: dress it; otherwise a swimsuit is painted on the skin.
        hairy: give it hair.
    """
    from scipy.sparse import csr_array, vstack

    person = who if isinstance(who, Person) else Person.draw(who, body.num_betas)
    rng = np.random.default_rng([person.seed, 1])
    shape = Shape(torch.tensor(person.betas[: body.num_betas], dtype=torch.float32))
    rest = body.rest(shape)
    vertices = rest.vertices.detach().double().numpy()
    faces = body.faces.numpy()
    joints = dict(zip(JOINTS, rest.joints.detach().double().numpy(), strict=True))
    weights = body.weights.detach().double().numpy()
    normals = vertex_normals(vertices, faces)
    look = Look(
        skin=person.skin,
        lips=tuple(s * f for s, f in zip(person.skin, (0.80, 0.45, 0.45), strict=True)),
        iris=person.iris, hair=person.hair, brows=tuple(0.5 * c for c in person.hair),
        top=person.top, bottom=person.bottom, shoes=person.shoes, swimsuit=not clothes,
        face=_find_face(body, shape, vertices, joints),
        nails=_find_nails(vertices, weights, joints), shoulder=_point(joints["left_shoulder"]),
        hip=_point(joints["left_hip"]), ground=float(vertices[:, 1].min()),
        accessory=person.accent,
    )  # fmt: skip

    surface = BodySurface(vertices, faces, normals)
    frame = Frame(surface, vertices, joints, weights)
    pieces: list[Piece] = []
    if clothes:
        pieces, cone = _dress(frame, person.wardrobe, rng)
        look = replace(look, cone=cone)
    if hairy:
        pieces.append(_groom(frame, person.wardrobe, rng, pieces))
    if clothes:
        pieces += _equip(frame, person.wardrobe)

    cloth = [piece.mesh for piece in pieces if piece.part not in (Part.HAIR, Part.ACCESSORY)]
    covered = _covered(vertices, cloth)
    skin = faces[~covered[faces].all(1)]
    used, skin = np.unique(skin, return_inverse=True)
    tint = _skin_tint(vertices, normals, weights, joints)
    skin = skin.reshape(-1, 3)
    of_skin = csr_array(
        (np.ones(len(used)), (np.arange(len(used)), used)), shape=(len(used), len(vertices))
    )
    bound = vstack([of_skin, *(piece.binding for piece in pieces)])
    meshes = [piece.mesh for piece in pieces]
    starts = np.cumsum([len(used), *(len(mesh.vertices) for mesh in meshes)])
    all_vertices = np.concatenate([vertices[used], *(m.vertices for m in meshes)])
    per_vertex = lambda of: np.concatenate(
        [np.zeros(len(used)), *(np.broadcast_to(of(p), len(p.mesh.vertices)) for p in pieces)]
    )
    return Subject(
        vertices=all_vertices.astype(np.float32),
        faces=np.concatenate([skin, *(m.faces + k for m, k in zip(meshes, starts, strict=False))]),
        binding=bound.tocsr(),
        weights=torch.from_numpy(bound @ weights).float(),
        tint=np.concatenate(
            [tint[used], *(np.repeat(m.shade[:, None], 3, axis=1) for m in meshes)]
        ).astype(np.float32),
        part=np.repeat(
            [int(Part.SKIN), *(int(piece.part) for piece in pieces)],
            [len(skin), *(len(m.faces) for m in meshes)],
        ).astype(np.uint32),
        look=look,
        shape=shape,
        slack=per_vertex(lambda piece: piece.slack),
        creases=creases(all_vertices, per_vertex(lambda piece: piece.crease), joints, rng),
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
    frame: Frame, wardrobe: Wardrobe, rng: np.random.Generator
) -> tuple[list[Piece], Cone | None]:
    """The clothes, and the cone that a skirt is."""
    surface, vertices, joints = frame.surface, frame.vertices, frame.joints
    reach = np.array([0.09, 0.09, 0.22 if wardrobe.bottom == "skirt" else 0.09])
    grid = Grid.around(vertices.min(0) - reach, vertices.max(0) + reach, CLOTH_CELL)
    d = surface.sample(grid)
    hem, loose, cone = wardrobe.hem, wardrobe.loose, None
    top = garments.shirt(grid, d, joints, loose, wardrobe.sleeve, hem, rng)
    if wardrobe.bottom == "skirt":
        bottom, cone = garments.skirt(grid, d, joints, wardrobe.flare, wardrobe.length, rng)
    else:
        bottom = garments.trousers(grid, d, joints, wardrobe.flare, wardrobe.length)
    height = lambda mesh: mesh.vertices[:, 1].astype(np.float64)
    follow = lambda mesh, smooth: binding.near(mesh.vertices, vertices, smooth)
    chest, hip = joints["spine3"][1], joints["left_hip"][1]
    low = smoothstep(chest - height(top), 0.0, chest - joints["pelvis"][1] + hem)
    out = np.abs(top.vertices[:, 0]) - joints["left_shoulder"][0]
    slack = 0.9 * loose * low + 0.35 * loose * smoothstep(out, 0.05, 0.4)
    pieces = [Piece(Part.TOP, top, follow(top, 0.025), slack, 0.15 * loose + 0.002)]
    drop = smoothstep(hip - height(bottom), 0.02, 0.4)
    if cone is not None:
        hangs = binding.hung(bottom.vertices, vertices, joints, frame.weights)
        pieces.append(Piece(Part.BOTTOM, bottom, hangs, 0.035 * drop))
    else:
        pieces.append(Piece(Part.BOTTOM, bottom, follow(bottom, 0.025), 0.4 * loose * drop, 0.004))
    for side in ("left", "right"):
        shoe = garments.shoe(surface, joints, side, 0.008)
        pieces.append(Piece(Part.SHOES, shoe, follow(shoe, 0.02)))
    return pieces, cone


def _groom(
    frame: Frame, wardrobe: Wardrobe, rng: np.random.Generator, dress: Sequence[Piece]
) -> Piece:
    shirts = [piece.mesh for piece in dress if piece.part is Part.TOP]
    worn = [BodySurface(m.vertices, m.faces, vertex_normals(m.vertices, m.faces)) for m in shirts]
    mesh = hair(frame.surface, frame.joints, wardrobe.hair, wardrobe.hair_thick, rng, *worn)
    below = frame.joints["head"][1] + 0.06 - mesh.vertices[:, 1].astype(np.float64)
    free = smoothstep(below, 0.0, 0.12)
    if wardrobe.hair == "long":  # what lies on the shoulders does not swing
        free = free * (1 - smoothstep(below, 0.12, 0.2))
    slack = {"short": 0.0, "bob": 0.014, "long": 0.012}[wardrobe.hair] * free
    return Piece(Part.HAIR, mesh, binding.near(mesh.vertices, frame.vertices, 0.03), slack)


def _equip(frame: Frame, wardrobe: Wardrobe) -> list[Piece]:
    meshes = []
    if wardrobe.glasses:
        meshes.append(accessories.glasses(frame.surface, frame.joints))
    if wardrobe.cap:
        stand_off = 1.35 * wardrobe.hair_thick + 0.004
        meshes.append(accessories.cap(frame.surface, frame.joints, stand_off))
    return [Piece(Part.ACCESSORY, m, binding.stiff(m.vertices, frame.weights)) for m in meshes]


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


def _find_face(
    body: BodyModel, shape: Shape, vertices: np.ndarray, joints: Mapping[str, np.ndarray]
) -> Face:
    """The mouth lies where the skin below the nose parts when the jaw drops."""
    eyes = np.stack([joints["left_eye_smplhf"], joints["right_eye_smplhf"]])
    unit, middle = float(np.linalg.norm(eyes[0] - eyes[1])), eyes.mean(0)
    x, y = np.abs(vertices[:, 0] - middle[0]), middle[1] - vertices[:, 1]
    near = vertices[(x < 0.2 * unit) & (y > 0.2 * unit) & (y < 1.1 * unit)]
    nose = near[near[:, 2].argmax()] if len(near) else middle + [0, -0.5 * unit, 0.4 * unit]
    mouth = np.array([middle[0], nose[1] - 0.44 * unit, nose[2] - 0.3 * unit])

    pose = Pose.rest(1, body.num_expressions)
    pose.rotations[:, JOINTS.index("jaw"), 0] = 0.15
    dropped = (body(pose, shape).vertices[0].double().numpy() - vertices)[:, 1]
    front = (x < 0.25 * unit) & (np.abs(vertices[:, 1] - mouth[1]) < 0.4 * unit)
    front &= vertices[:, 2] > mouth[2] - 0.3 * unit
    edges = body.faces.numpy()[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges = edges[front[edges].all(1)]
    if len(edges):
        torn = np.abs(dropped[edges[:, 0]] - dropped[edges[:, 1]])
        most = edges[torn > 0.7 * torn.max()] if torn.max() > 0.002 else edges[:0]
        if len(most):
            mouth[1:] = vertices[most].mean((0, 1))[1:]
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
