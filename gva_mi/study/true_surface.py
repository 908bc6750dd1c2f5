"""The true outer surface of a synthetic subject, where an avatar's Gaussians should lie.

Gaussians live in the rest pose of the avatar's own body, whose betas may be wrong: a subject taken
for a larger one has a larger avatar, which is not an error. So the surface is transferred to it,

    x = x* + Σ_v b_xv (V_v - V*_v)

with V the vertices of the avatar's rest body, V* those of the true body, and b the weights of the
body vertices that a point of skin, cloth or hair follows.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from gva_mi.avatar.canonical import spread_over_faces
from gva_mi.avatar.rig import Rig
from gva_mi.body.pose import Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.mesh.surface import vertex_normals
from gva_mi.mesh.visibility import seen_vertices
from gva_mi.synthetic import remake_subject
from gva_mi.synthetic.provenance import recorded_options
from gva_mi.synthetic.subject import Subject
from gva_mi.synthetic.texture import Fabric, Material

POINTS = 40_000  # spread over the surface by area: some 7 mm apart
DISTANCE = 4.0  # metres from the person's centre to the cameras around
# Azimuths and elevations of the cameras. From below they would see into a skirt.
AROUND = (np.arange(12) * np.pi / 6, np.radians([0.0, 20.0, 50.0]))
HEM = 0.8  # share of a garment's slack beyond which a face belongs to the hem

TEXTURES = ("skin", "plain cloth", "patterned cloth", "hair")
PARTS = ("hair", "hem", "accessories", "rest")


@dataclass(frozen=True)
class TrueSurface:
    """Evenly spread points of the visible true surface, in the rest pose of an avatar."""

    points: np.ndarray  # (M, 3) metres
    normals: np.ndarray  # (M, 3)
    texture: np.ndarray  # (M,) integers, see TEXTURES
    part: np.ndarray  # (M,) integers, see PARTS
    everywhere: np.ndarray  # (M, 3) metres, on the whole surface, visible or not

    @staticmethod
    def of(subject: Path, body: BodyModel, rig: Rig) -> TrueSurface | None:
        """Make the surface of a subject that ``gva-mi synth`` made, for an avatar's rig.

        Returns:
            None if the subject's body has other vertices than the fitted ``body``, or if an older
            program drew the subject differently.

        Raises:
            InputError: the folder was not made by ``gva-mi synth``, or on another body.
        """
        if recorded_options(subject)[1].figure == "anny":  # has vertices of its own
            return None
        again = remake_subject(subject, body)
        if again is None:
            return None
        person, drawn_on = again
        with torch.no_grad():
            own = body.rest(Shape(rig.betas)).vertices.double().numpy()
            true = drawn_on.rest(person.shape).vertices.double().numpy()
        vertices = person.vertices + person.binding @ (own - true)
        return _spread(person, torch.from_numpy(vertices), _outside(person))


def _spread(person: Subject, vertices: torch.Tensor, outside: np.ndarray) -> TrueSurface:
    """Spread points on the visible faces."""
    faces = torch.from_numpy(person.faces)
    normals = vertex_normals(vertices, faces)
    anywhere, at = spread_over_faces(vertices, faces, POINTS)
    kept = faces[torch.from_numpy(outside)]
    chosen, barycentric = spread_over_faces(vertices, kept, POINTS)
    on_faces = lambda x: (x[kept[chosen]] * barycentric[..., None]).sum(1).numpy()
    of_face = np.flatnonzero(outside)[chosen.numpy()]
    normal = on_faces(normals)
    return TrueSurface(
        points=on_faces(vertices),
        normals=normal / np.linalg.norm(normal, axis=1, keepdims=True),
        texture=_textures(person)[of_face],
        part=_parts(person)[of_face],
        everywhere=(vertices[faces[anywhere]] * at[..., None]).sum(1).numpy(),
    )


def _outside(person: Subject) -> np.ndarray:
    """Tell which faces (F,) some camera around the rest pose sees.

    Gaussians need not reach the inner sides of cloth and hair, or skin under a skirt.
    """
    vertices = torch.from_numpy(person.vertices)
    low, high = person.vertices.min(0), person.vertices.max(0)
    azimuth, height = (x.ravel() for x in np.meshgrid(*AROUND))
    flat = np.cos(height)
    away = np.stack([flat * np.sin(azimuth), np.sin(height), flat * np.cos(azimuth)], axis=1)
    eyes = (low + high) / 2 + DISTANCE * away
    seen = seen_vertices(vertices, torch.from_numpy(person.faces), eyes).any(0).numpy()
    return seen[person.faces].all(1)


def _textures(person: Subject) -> np.ndarray:
    """Return the texture of each face (F,)."""

    def cloth(fabric: Fabric) -> int:
        return 1 if fabric.pattern in ("smooth", "plain") else 2

    of = {
        Material.SKIN: 0, Material.TOP: cloth(person.look.top),
        Material.BOTTOM: cloth(person.look.bottom), Material.SHOES: 1, Material.HAIR: 3,
        Material.ACCESSORY: 1,
    }  # fmt: skip
    return np.array([of[material] for material in Material])[person.material]


def _parts(person: Subject) -> np.ndarray:
    """Return the part of each face (F,)."""
    parts = np.full(len(person.faces), PARTS.index("rest"))
    slack = person.slack[person.faces].mean(1)
    for material in (Material.TOP, Material.BOTTOM):
        own = person.material == int(material)
        if slack[own].any():
            parts[own & (slack >= HEM * slack[own].max())] = PARTS.index("hem")
    for material, name in ((Material.HAIR, "hair"), (Material.ACCESSORY, "accessories")):
        parts[person.material == int(material)] = PARTS.index(name)
    return parts
