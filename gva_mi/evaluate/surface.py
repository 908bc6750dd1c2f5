"""The two effects of the paper's Figure 2 as numbers, before and after each re-initialisation.

*Unbalanced aggregation*: cloning and splitting crowd Gaussians where texture is rich. On the
surface,

    1. d_i = min_{j ≠ i} |f_i - f_j|          f: foot of a Gaussian on the true surface
    2. spacing = std(d) / mean(d)             0 on a lattice, 0.52 for random points

*Initialisation bias*: Gaussians seeded on the naked body do not reach hair and loose clothes. Over
points x spread evenly over a part of the true surface,

    3. bias = 95th percentile of min_i |x - μ_i|

Re-initialisation should remove *floaters*,

    4. stray = 99th percentile of min_x |x - μ_i|          x: on the inner sides of cloth, too

Only opaque Gaussians count, and for (2) only those near the surface. (3) and (4) cannot fall below
half the distance between Gaussians, or between points.

Gaussians live in the rest pose of the avatar's own body, whose betas may be wrong: a subject taken
for a larger one has a larger avatar, which is not an error. So the true surface x* is transferred,

    5. x = x* + Σ_v b_xv (V_v - V*_v)

with V the vertices of the avatar's rest body, V* of the true body, and b the weights of the
body vertices that a point of skin, cloth or hair follows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from gva_mi.avatar.avatar import Avatar
from gva_mi.avatar.canonical import spread_over_faces
from gva_mi.avatar.rig import Rig
from gva_mi.body.pose import Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.evaluate.figures import Figure
from gva_mi.fit import run_folder
from gva_mi.mesh.mesh_scene import seen_vertices
from gva_mi.mesh.surface import vertex_normals
from gva_mi.subject.folder import SYNTH
from gva_mi.synthetic import remake_subject
from gva_mi.synthetic.folder import recorded_options
from gva_mi.synthetic.person.surface import PersonSurface
from gva_mi.synthetic.person.texture import Material

OPAQUE_ABOVE = 0.5  # opacity above which a Gaussian counts; chosen: it hides most of what is behind
SURFACE_BAND = 0.03  # metres from the surface; chosen: beyond it are floaters
FEWEST_POINTS = 50  # Gaussians, or points, that a figure needs; chosen: percentiles mean something

SURFACE_POINTS = 40_000  # spread over the surface by area; chosen: some 7 mm apart
EYE_DISTANCE = 4.0  # metres from the person's centre to the cameras around; chosen: as a video's
# Azimuths and elevations of the cameras, rad. From below they would see into a skirt.
EYE_ANGLES = (np.arange(12) * np.pi / 6, np.radians([0.0, 20.0, 50.0]))
HEM_SLACK = 0.8  # share of a garment's slack beyond which a face is hem; chosen: the last fifth

AT_END = "end"  # how figures name the moment at the end of the fit, beside re-initialisations
PARTS = ("hair", "hem", "rest")


def surface_figures(run: Path, avatar: Avatar, subject: Path, body: BodyModel) -> Iterator[Figure]:
    """Measure a run before and after each re-initialisation, and at its end.

    Nothing is yielded if the true surface is unknown. The split of a figure is its moment.

    Args:
        run: the folder of the finished fit.
        avatar: the fitted avatar.
        subject: the folder it was fitted to.
        body: the fitted body model.
    """
    truth = TrueSurface.of(subject, body, avatar.rig) if (subject / SYNTH).is_file() else None
    if truth is None:
        return
    moments = []
    for snapshot in run_folder.load_snapshots(run):
        moments.append((f"step {snapshot.step:,}, before", snapshot.before))
        moments.append((after := f"step {snapshot.step:,}, after", snapshot.after))
        area, left = snapshot.surface.areas().sum(), snapshot.surface.open_edges()
        yield Figure(split=after, metric="area, m²", value=float(area))
        yield Figure(split=after, metric="open edges", value=left)
    for moment, gaussians in (*moments, (AT_END, avatar.canonical)):
        opaque = gaussians.opacities.detach() > OPAQUE_ABOVE
        means = gaussians.means.detach()[opaque].double().numpy()
        if len(means) < FEWEST_POINTS:
            continue
        yield Figure(split=moment, metric="opaque Gaussians", value=len(means))
        yield Figure(split=moment, metric="spacing", value=spacing(means, truth))
        for part, value in bias_mm(means, truth).items():
            yield Figure(split=moment, region=part, metric="bias, mm", value=value)
        yield Figure(split=moment, metric="stray, mm", value=stray_mm(means, truth))


def spacing(means: np.ndarray, truth: TrueSurface) -> float | None:
    """Evaluate eq. 2 on Gaussians (N, 3); None for a few."""
    from scipy.spatial import cKDTree

    distance, nearest = cKDTree(truth.points).query(means, workers=-1)
    near = distance < SURFACE_BAND
    means, nearest = means[near], nearest[near]
    normals = truth.normals[nearest]
    height = ((means - truth.points[nearest]) * normals).sum(1, keepdims=True)
    if len(means) < FEWEST_POINTS:
        return None
    feet = means - height * normals
    apart = cKDTree(feet).query(feet, k=2, workers=-1)[0][:, 1]
    return float(apart.std() / apart.mean())


def bias_mm(means: np.ndarray, truth: TrueSurface) -> dict[str, float]:
    """Evaluate eq. 3 on Gaussians (N, 3), for each part that the person has, millimetres."""
    from scipy.spatial import cKDTree

    distance = 1e3 * cKDTree(means).query(truth.points, workers=-1)[0]
    return {
        name: float(np.percentile(distance[truth.part == k], 95))
        for k, name in enumerate(PARTS)
        if (truth.part == k).sum() >= FEWEST_POINTS
    }


def stray_mm(means: np.ndarray, truth: TrueSurface) -> float:
    """Evaluate eq. 4 on Gaussians (N, 3), millimetres."""
    from scipy.spatial import cKDTree

    return float(1e3 * np.percentile(cKDTree(truth.everywhere).query(means, workers=-1)[0], 99))


@dataclass(frozen=True)
class TrueSurface:
    """Evenly spread points of the visible true surface, in the rest pose of an avatar."""

    points: np.ndarray  # (M, 3) metres
    normals: np.ndarray  # (M, 3)
    part: np.ndarray  # (M,) integers, see PARTS
    everywhere: np.ndarray  # (M, 3) metres, on the whole surface, visible or not

    @staticmethod
    def of(subject: Path, body: BodyModel, rig: Rig) -> TrueSurface | None:
        """Make the surface of a subject that ``gva-mi synth`` made, for an avatar's rig.

        Returns:
            None if the subject's body has other vertices than the fitted ``body``.

        Raises:
            InputError: the folder was not made by ``gva-mi synth``, or on another body.
        """
        if recorded_options(subject)[1].figure == "anny":  # this body has other vertices
            return None
        person, drawn_on = remake_subject(subject, body)
        with torch.no_grad():
            fitted = body.rest(Shape(rig.betas)).vertices.double().numpy()
            true = drawn_on.rest(person.shape).vertices.double().numpy()
        vertices = person.vertices + person.binding @ (fitted - true)
        return _spread(person, torch.from_numpy(vertices), _outside(person))


def _spread(person: PersonSurface, vertices: torch.Tensor, outside: np.ndarray) -> TrueSurface:
    """Spread points on the visible faces."""
    faces = torch.from_numpy(person.faces)
    normals = vertex_normals(vertices, faces)
    anywhere, at = spread_over_faces(vertices, faces, SURFACE_POINTS)
    kept = faces[torch.from_numpy(outside)]
    chosen, barycentric = spread_over_faces(vertices, kept, SURFACE_POINTS)
    on_faces = lambda x: (x[kept[chosen]] * barycentric[..., None]).sum(1).numpy()
    of_face = np.flatnonzero(outside)[chosen.numpy()]
    normal = on_faces(normals)
    return TrueSurface(
        points=on_faces(vertices),
        normals=normal / np.linalg.norm(normal, axis=1, keepdims=True),
        part=_parts(person)[of_face],
        everywhere=(vertices[faces[anywhere]] * at[..., None]).sum(1).numpy(),
    )


def _outside(person: PersonSurface) -> np.ndarray:
    """Return the faces (F,) bool that a camera around the rest pose sees.

    Gaussians need not reach the inner sides of cloth and hair, or skin under a skirt.
    """
    vertices = torch.from_numpy(person.vertices)
    low, high = person.vertices.min(0), person.vertices.max(0)
    azimuth, height = (x.ravel() for x in np.meshgrid(*EYE_ANGLES))
    flat = np.cos(height)
    away = np.stack([flat * np.sin(azimuth), np.sin(height), flat * np.cos(azimuth)], axis=1)
    eyes = (low + high) / 2 + EYE_DISTANCE * away
    seen = seen_vertices(vertices, torch.from_numpy(person.faces), eyes).any(0).numpy()
    return seen[person.faces].all(1)


def _parts(person: PersonSurface) -> np.ndarray:
    """Return the part of each face (F,)."""
    parts = np.full(len(person.faces), PARTS.index("rest"))
    slack = person.slack[person.faces].mean(1)
    for material in (Material.TOP, Material.BOTTOM):
        garment = person.material == int(material)
        if slack[garment].any():
            parts[garment & (slack >= HEM_SLACK * slack[garment].max())] = PARTS.index("hem")
    parts[person.material == int(Material.HAIR)] = PARTS.index("hair")
    return parts
