"""A synthetic person as one surface that moves with the body: skin, clothes, hair and colours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
import torch

from gva_mi.body.pose import Pose, Shape
from gva_mi.body.skinning import skin_points
from gva_mi.body.smplx import BodyModel
from gva_mi.synthetic.clothes.dressing import Worn, covered, dress
from gva_mi.synthetic.clothes.folds import Crease, creases, lag
from gva_mi.synthetic.look import Look, Material
from gva_mi.synthetic.people import SyntheticPerson
from gva_mi.synthetic.rest_body import RestBody, face_landmarks
from gva_mi.synthetic.surface import vertex_normals

if TYPE_CHECKING:
    from scipy.sparse import csr_array


@dataclass(frozen=True)
class Subject:
    """A person's outer surface in the rest pose, without the skin under clothes."""

    vertices: np.ndarray  # (N, 3) float32 metres
    faces: np.ndarray  # (F, 3) int64
    binding: csr_array  # (N, V) rows sum to 1: the vertices of the body that a vertex follows
    weights: torch.Tensor  # (N, 55) skinning weights, from these vertices
    tint: np.ndarray  # (N, 3) float32, factor on the colour: dark openings, red knuckles
    material: np.ndarray  # (F,) uint32, see Material
    look: Look
    shape: Shape
    slack: np.ndarray  # (N,) metres, the most that loose ends may lag behind
    creases: tuple[Crease, ...]

    def posed(self, body: BodyModel, pose: Pose, past: Sequence[Pose] = ()) -> np.ndarray:
        """Return the surface in the world, (T, N, 3) float32, metres.

        It is skinned like the ``body`` it is drawn on, and follows the body's pose correctives.
        Creases and lags of ``clothes.folds`` are added. Poses of the ``past``, one step, two steps,
        ... before the T frames, let loose ends lag.
        """
        skinned = self.skinned(body, pose)
        loose = np.flatnonzero(self.slack > 0) if past else np.zeros(0, int)
        before = [self.skinned(body, p, loose) for p in past] if len(loose) else []
        rotations = pose.rotations.double().numpy()
        for k, surface in enumerate(skinned):
            moved = np.zeros(surface.shape)
            if before:
                now, then = surface[loose], np.stack([b[k] for b in before])
                # Away from the body: unlike normals, the same on both sides of a hem.
                below = self.binding[loose] @ body(pose[k], self.shape).vertices[0].numpy()
                away = now - below
                away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-6)
                moved[loose] += lag(now, then, self.slack[loose], away)
            normals = vertex_normals(surface.astype(np.float64), self.faces)
            for crease in self.creases:
                height = crease.displacement(rotations[k, crease.joint])
                moved[crease.index] += height[:, None] * normals[crease.index]
            skinned[k] = surface + moved
        return skinned

    def skinned(self, body: BodyModel, pose: Pose, index: np.ndarray | None = None) -> np.ndarray:
        """Return vertices in the world without folds, (T, n, 3) float32; all without ``index``."""
        index = np.arange(len(self.vertices)) if index is None else index
        rest, points = body.rest(self.shape).vertices, torch.from_numpy(self.vertices[index])
        weights, binding = self.weights[torch.from_numpy(index)], self.binding[index]
        frames = []
        for k in range(len(pose)):
            posed = body(pose[k], self.shape)
            T = posed.T_world_rest[0]
            corrected = posed.vertices[0] - skin_points(rest, body.weights, T)
            frames.append(skin_points(points, weights, T).numpy() + binding @ corrected.numpy())
        return np.stack(frames).astype(np.float32)


@lru_cache(maxsize=1)  # a program that made a subject often measures it next
def draw_subject(
    body: BodyModel,
    person: SyntheticPerson,
    clothes: bool = True,
    hair: bool = True,
) -> Subject:
    """Make the surface of a person on a body.

    Without clothes, a swimsuit is painted on the skin; without hair, the head is bald.
    """
    rng = np.random.default_rng([person.seed, 1])
    shape = Shape(torch.tensor(person.betas[: body.num_betas], dtype=torch.float32))
    rest = RestBody.of(body, shape)
    worn = dress(rest, person.outfit, rng, clothes, hair)
    shoulder, hip = (tuple(rest.joints[f"left_{name}"].tolist()) for name in ("shoulder", "hip"))
    look = Look(
        skin=person.skin,
        lips=tuple(s * f for s, f in zip(person.skin, (0.80, 0.45, 0.45), strict=True)),
        iris=person.iris, hair=person.hair, brows=tuple(0.5 * c for c in person.hair),
        top=person.top, bottom=person.bottom, shoes=person.shoes, swimsuit=not clothes,
        face=face_landmarks(body, shape, rest), nails=rest.nails(),
        shoulder=shoulder, hip=hip, ground=float(rest.vertices[:, 1].min()),
        accessory=person.accent, cone=worn.cone,
    )  # fmt: skip
    return _joined(rest, worn, look, shape, rng)


def _joined(
    rest: RestBody, worn: Worn, look: Look, shape: Shape, rng: np.random.Generator
) -> Subject:
    """Join the visible skin and all pieces to one surface."""
    from scipy.sparse import csr_array, vstack

    skin = rest.faces[~covered(rest.vertices, worn.cloth)[rest.faces].all(1)]
    used, skin = np.unique(skin, return_inverse=True)
    skin = skin.reshape(-1, 3)
    of_skin = csr_array(
        (np.ones(len(used)), (np.arange(len(used)), used)), shape=(len(used), len(rest.vertices))
    )
    pieces, meshes = worn.pieces, [piece.mesh for piece in worn.pieces]
    bound = vstack([of_skin, *(piece.binding for piece in pieces)])
    starts = np.cumsum([len(used), *(len(mesh.vertices) for mesh in meshes)])
    vertices = np.concatenate([rest.vertices[used], *(m.vertices for m in meshes)])
    shades = [np.repeat(m.shade[:, None], 3, axis=1) for m in meshes]
    per_vertex = lambda of: np.concatenate(
        [np.zeros(len(used)), *(np.broadcast_to(of(p), len(p.mesh.vertices)) for p in pieces)]
    )
    return Subject(
        vertices=vertices.astype(np.float32),
        faces=np.concatenate([skin, *(m.faces + k for m, k in zip(meshes, starts, strict=False))]),
        binding=bound.tocsr(),
        weights=torch.from_numpy(bound @ rest.weights).float(),
        tint=np.concatenate([rest.skin_tint()[used], *shades]).astype(np.float32),
        material=np.repeat(
            [int(Material.SKIN), *(int(piece.material) for piece in pieces)],
            [len(skin), *(len(m.faces) for m in meshes)],
        ).astype(np.uint32),
        look=look,
        shape=shape,
        slack=per_vertex(lambda piece: piece.slack),
        creases=creases(vertices, per_vertex(lambda piece: piece.crease), rest.joints, rng),
    )
