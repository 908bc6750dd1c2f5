"""The two effects of the paper's Figure 2 as numbers, before and after each re-initialisation.

*Unbalanced aggregation*: cloning and splitting crowd Gaussians where texture is rich. On the
surface, over the Gaussians of one texture,

    1. d_i = min_{j ≠ i} |f_i - f_j|          f: foot of a Gaussian on the true surface
    2. spacing = std(d) / mean(d)             0 on a lattice, 0.52 for random points

*Initialisation bias*: Gaussians seeded on the naked body do not reach hair and loose clothes. Over
points x spread evenly over a part of the true surface,

    3. bias = 95th percentile of min_i |x - μ_i|

*Floaters* are what re-initialisation should remove. Needles come apart where skin bends, and huge
Gaussians hide their neighbours. With a Gaussian's standard deviations s_1 >= s_2 >= s_3,

    4. stray = 99th percentile of min_x |x - μ_i|          x: on the inner sides of cloth, too
    5. elongation = 99th percentile of s_1 / s_2           1 for a disc of the surface
    6. largest = max s_1

Only opaque Gaussians count, and for (2) only those near the surface. (3) and (4) cannot fall below
half the distance between Gaussians, or between points.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.smplx import BodyModel
from gva_mi.data.fingerprint import ABOUT
from gva_mi.fit import run_folder
from gva_mi.study.true_surface import PARTS, TEXTURES, TrueSurface

OPAQUE = 0.5  # opacity above which a Gaussian counts
NEAR = 0.03  # metres from the surface; beyond it are floaters
FEWEST = 50  # Gaussians, or points, that a figure needs


@dataclass(frozen=True)
class SurfaceFigures:
    """How the Gaussians lie on the true surface at one moment of a fit."""

    step: int
    moment: str  # "before" or "after" a re-initialisation, or "end" of the fit
    gaussians: int  # opaque ones
    spacing: dict[str, float]  # eq. 2 by texture, and of "all"
    bias_mm: dict[str, float]  # eq. 3 by part
    stray_mm: float | None = None  # eq. 4; it and the next are None in files of older versions
    elongation: float | None = None  # eq. 5
    largest_mm: float | None = None  # eq. 6


def surface_figures(
    run: Path, avatar: Avatar, subject: Path, body: BodyModel
) -> tuple[SurfaceFigures, ...]:
    """Measure a run, in the order of its steps; empty if the true surface is unknown.

    Args:
        run: the folder of the finished fit.
        avatar: the fitted avatar.
        subject: the folder it was fitted to.
        body: the fitted body model.
    """
    if not (subject / ABOUT).is_file():
        return ()
    truth = TrueSurface.of(subject, body, avatar.rig)
    if truth is None:
        return ()
    moments = []
    for snapshot in run_folder.load_snapshots(run):
        moments.append((snapshot.step, "before", snapshot.before))
        moments.append((snapshot.step, "after", snapshot.after))
    moments.append((len(run_folder.load_history(run)["loss"]), "end", avatar.canonical))
    found = []
    for step, moment, gaussians in moments:
        opaque = gaussians.opacities.detach() > OPAQUE
        means = gaussians.means.detach()[opaque].double().numpy()
        if len(means) >= FEWEST:
            figures = spacing(means, truth), bias_mm(means, truth), stray_mm(means, truth)
            sizes = elongation_and_largest(gaussians.scales.detach()[opaque].double().numpy())
            found.append(SurfaceFigures(step, moment, len(means), *figures, *sizes))
    return tuple(found)


def spacing(means: np.ndarray, truth: TrueSurface) -> dict[str, float]:
    """Evaluate eq. 2 on Gaussians (N, 3), for each texture that has enough, and for all."""
    from scipy.spatial import cKDTree

    distance, nearest = cKDTree(truth.points).query(means)
    near = distance < NEAR
    means, nearest = means[near], nearest[near]
    normals = truth.normals[nearest]
    height = ((means - truth.points[nearest]) * normals).sum(1, keepdims=True)
    feet, texture = means - height * normals, truth.texture[nearest]
    apart = cKDTree(feet).query(feet, k=2)[0][:, 1]
    groups = {"all": np.ones(len(feet), dtype=bool)}
    groups |= {name: texture == k for k, name in enumerate(TEXTURES)}
    return {
        name: float(apart[own].std() / apart[own].mean())
        for name, own in groups.items()
        if own.sum() >= FEWEST
    }


def bias_mm(means: np.ndarray, truth: TrueSurface) -> dict[str, float]:
    """Evaluate eq. 3 on Gaussians (N, 3), for each part that the person has, millimetres."""
    from scipy.spatial import cKDTree

    distance = 1e3 * cKDTree(means).query(truth.points)[0]
    return {
        name: float(np.percentile(distance[truth.part == k], 95))
        for k, name in enumerate(PARTS)
        if (truth.part == k).sum() >= FEWEST
    }


def stray_mm(means: np.ndarray, truth: TrueSurface) -> float:
    """Evaluate eq. 4 on Gaussians (N, 3), millimetres."""
    from scipy.spatial import cKDTree

    return float(1e3 * np.percentile(cKDTree(truth.everywhere).query(means)[0], 99))


def elongation_and_largest(scales: np.ndarray) -> tuple[float, float]:
    """Evaluate eq. 5, and eq. 6 in millimetres, on standard deviations (N, 3)."""
    _, second, first = np.sort(scales, axis=1).T
    return float(np.percentile(first / second, 99)), float(1e3 * first.max())
