"""A synthetic person as one surface that moves with the body: skin, clothes, hair and colours.

Cloth and hair have a motion of their own: creases at bent joints, and loose ends that lag behind.
At a joint whose rotation bends its bone b (rest pose) by the axis-angle r,

    1. strength  s = |r⊥|² / (|r⊥|² + 0.5²)                r⊥ is r without the twist about b
    2. inside    g = ½ + ½ cos(angle of x about b to r × b)
    3. crease    h = a(x) · window(x) · cos(2π b·(x − J) / 4 cm + phase(x)) · s · g

displaces along the posed normal. Loose ends lag: with p_k the skinned position k steps back and ℓ
the slack, the largest displacement of a vertex,

    4. lag       u = Σ_k w_k p_k − p_0,   displacement ℓ u / √(ℓ² + |u|²),   w_k ~ exp(−k / 2)

Both are smooth in the pose. Creases vanish in the rest pose, lags without motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from typing import TYPE_CHECKING

import numpy as np
import torch
from numpy.random import Generator

from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.body.skinning import skin_points
from gva_mi.body.smplx import BodyModel
from gva_mi.synthetic.person.bodies import RestBody, face_landmarks
from gva_mi.synthetic.person.dressing import Piece, covered, dress
from gva_mi.synthetic.person.identity import SyntheticPerson
from gva_mi.synthetic.person.level_sets import vertex_normals
from gva_mi.synthetic.person.texture import Look, Material

if TYPE_CHECKING:
    from scipy.sparse import csr_array

BONES: Mapping[str, str] = {  # joint -> the end of its bone
    "left_elbow": "left_wrist", "right_elbow": "right_wrist", "left_shoulder": "left_elbow",
    "right_shoulder": "right_elbow", "left_knee": "left_ankle", "right_knee": "right_ankle",
    "left_hip": "left_knee", "right_hip": "right_knee", "spine1": "spine2", "spine2": "spine3",
}  # fmt: skip
# Folds, chosen by eye.
CREASE_WAVELENGTH = 0.04  # m, from crease to crease
CREASE_LENGTH, CREASE_RADIUS = 0.075, 0.15  # m, extent of creases along the bone and across it
HALF_BEND = 0.5  # rad, bend at which a crease has half its height (eq. 1)
LAG_STEPS = 5  # of motions.LAG_TIME_STEP, that a lag depends on: earlier ones weigh under a tenth
INWARD_DAMPING = 0.6  # fraction removed from a lag into the body


@dataclass(frozen=True)
class Crease:
    """The creases of one joint."""

    joint: int
    bone: np.ndarray  # (3,) unit, rest pose
    index: np.ndarray  # (n,) vertices
    height: np.ndarray  # (n,) metres: a · window · cos of eq. 3
    around: np.ndarray  # (n, 3) unit, from the bone to the vertex

    def displacement(self, rotation: np.ndarray) -> np.ndarray:
        """Return displacements (n,) along the normals, metres, for an axis-angle rotation (3,)."""
        across = rotation - self.bone * (rotation @ self.bone)
        bend = np.linalg.norm(across)
        if bend < 1e-6:
            return np.zeros_like(self.height)
        inner = np.cross(across / bend, self.bone)
        strength = bend**2 / (bend**2 + HALF_BEND**2)
        return self.height * strength * (0.5 + 0.5 * (self.around @ inner))


@dataclass(frozen=True)
class PersonSurface:
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


_last: dict[tuple[object, ...], PersonSurface] = {}  # what draw_surface returned last


def draw_surface(body: BodyModel, person: SyntheticPerson, bare: bool = False) -> PersonSurface:
    """Make the surface of a person on a body: dressed, or ``bare``, bald and in a swimsuit.

    The last one is kept: a program that made a subject often measures it next. By then it has
    loaded the body again, so bodies are compared by their arrays.
    """
    arrays = (np.ascontiguousarray(x) for x in body.buffers())
    key = *(sha256(x).digest() for x in arrays), person, bare
    if key not in _last:
        drawn = _draw_surface(body, person, bare)
        _last.clear()
        _last[key] = drawn
    return _last[key]


def _draw_surface(body: BodyModel, person: SyntheticPerson, bare: bool) -> PersonSurface:
    rng = np.random.default_rng([person.seed, 1])
    shape = Shape(torch.tensor(person.betas[: body.num_betas], dtype=torch.float32))
    rest = RestBody.of(body, shape)
    pieces, cone = ([], None) if bare else dress(rest, person.outfit, rng)
    shoulder, hip = (tuple(rest.joints[f"left_{name}"].tolist()) for name in ("shoulder", "hip"))
    face, ground = face_landmarks(body, shape, rest), float(rest.vertices[:, 1].min())
    look = Look(person, bare, face, rest.nails(), shoulder, hip, ground, cone)
    return _joined(rest, pieces, look, shape, rng)


def _joined(
    rest: RestBody, pieces: list[Piece], look: Look, shape: Shape, rng: Generator
) -> PersonSurface:
    """Join the visible skin and all pieces to one surface."""
    from scipy.sparse import csr_array, vstack

    cloth = [piece.mesh for piece in pieces if piece.material is not Material.HAIR]
    skin = rest.faces[~covered(rest.vertices, cloth)[rest.faces].all(1)]
    used, skin = np.unique(skin, return_inverse=True)
    skin = skin.reshape(-1, 3)
    ones = np.ones(len(used)), (np.arange(len(used)), used)
    of_skin = csr_array(ones, shape=(len(used), len(rest.vertices)))
    meshes = [piece.mesh for piece in pieces]
    bound = vstack([of_skin, *(piece.binding for piece in pieces)])
    starts = np.cumsum([len(used), *(len(mesh.vertices) for mesh in meshes)])
    vertices = np.concatenate([rest.vertices[used], *(m.vertices for m in meshes)])
    shades = [np.repeat(m.shade[:, None], 3, axis=1) for m in meshes]
    per_vertex = lambda of: np.concatenate(
        [np.zeros(len(used)), *(np.broadcast_to(of(p), len(p.mesh.vertices)) for p in pieces)]
    )
    return PersonSurface(
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


def creases(
    vertices: np.ndarray, amplitude: np.ndarray, joints: Mapping[str, np.ndarray], rng: Generator
) -> tuple[Crease, ...]:
    """Place the creases of all joints at random on vertices (N, 3), rest pose, metres.

    Their height is ``amplitude`` (N,), metres; zero where there are none.
    """
    folds = []
    cloth = np.flatnonzero(amplitude > 0)
    for name, child in BONES.items():
        bone = joints[child] - joints[name]
        bone = bone / np.linalg.norm(bone)
        away = vertices[cloth] - joints[name]
        along = away @ bone
        radial = away - along[:, None] * bone
        radius = np.linalg.norm(radial, axis=1)
        window = np.exp(-((along / CREASE_LENGTH) ** 2) - (radius / CREASE_RADIUS) ** 4)
        near = window > 0.02
        slant = rng.normal(0, 22, 3)  # rad/m
        phase = 2 * np.pi * along / CREASE_WAVELENGTH + away @ slant + rng.uniform(0, 2 * np.pi)
        height = amplitude[cloth] * window * np.cos(phase)
        around = radial / np.maximum(radius, 1e-6)[:, None]
        folds.append(Crease(JOINTS.index(name), bone, cloth[near], height[near], around[near]))
    return tuple(folds)


def lag(now: np.ndarray, past: np.ndarray, slack: np.ndarray, away: np.ndarray) -> np.ndarray:
    """Return displacements (n, 3) of loose ends (eq. 4), metres.

    ``now`` (n, 3) and ``past`` (LAG_STEPS, n, 3), the latest first, are skinned positions.
    ``slack`` (n,) is the largest displacement, metres, and ``away`` (n, 3) points from the body to
    the vertex.
    """
    weights = np.exp(-np.arange(1, LAG_STEPS + 1) / 2)
    behind = np.tensordot(weights / weights.sum(), past, axes=1) - now
    bounded = behind * (slack / np.sqrt(slack**2 + (behind**2).sum(1)))[:, None]
    inward = np.minimum((bounded * away).sum(1), 0)
    return bounded - INWARD_DAMPING * inward[:, None] * away
