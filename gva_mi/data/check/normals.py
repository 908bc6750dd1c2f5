"""Check the axes of the normal maps: their order and signs, compared with the body's own normals.

With n the normals of a map and b those of the body, in the camera's axes, over the N pixels that
both show,

    1. M = Σ b nᵀ / N
    2. mean cos of b and S n = Σ_i s_i M[i, π(i)]      for n with axes π exchanged, and signs s

so the best of all 48 ways to write a normal follows from nine sums. The plain one has to be the
best, up to chance: its loss to the best must be below a quarter of what it lacks, in most frames.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from gva_mi.core.errors import InputError
from gva_mi.data.check.frames import CheckedFrames
from gva_mi.data.check.problems import Problem, doubt, error
from gva_mi.data.normals import NormalMaps
from gva_mi.splat import Camera

FEWEST_PIXELS = 50  # of a frame: fewer say nothing about three axes
FOLLOWS = 0.5  # mean cosine of unrelated directions: all that is seen faces the camera
WORTH = 0.25
_AXES = "camera space: x right, y down, z forward; (n + 1) / 2 in PNG"
_WAYS = [
    (axes, signs)
    for axes in itertools.permutations(range(3))
    for signs in itertools.product((1, -1), repeat=3)
]
_NAMED = {
    ((0, 1, 2), (1, -1, -1)): ("y up and z toward the viewer, as in ICON's or OpenGL's maps",
                               "refine --normals icon or opengl, or normals.json"),
    ((2, 1, 0), (1, 1, 1)): ("blue and red are exchanged", "write RGB, not BGR"),
}  # fmt: skip


def check_normals(
    maps: NormalMaps, frames: CheckedFrames, images: np.ndarray, cameras: dict[int, Camera]
) -> Iterator[Problem]:
    """Yield problems of the maps, by the body's normals and silhouettes, images (n, h, w, 4).

    ``cameras`` are those of the frames in full size, by number.
    """
    found = []
    for i, number in enumerate(frames.numbers):
        try:
            normals = maps.read(number, cameras[number])
        except InputError:  # reported when the maps were opened
            continue
        if normals is not None:
            rows, columns = (  # at the middles of the small picture's pixels
                ((np.arange(n) + 0.5) * total / n).astype(int)
                for n, total in zip(frames.masks.shape[1:], normals.shape[:2], strict=True)
            )
            normals = normals[rows[:, None], columns[None]]
            both = (normals != 0).any(-1) & frames.masks[i] & (images[i, ..., 3] > 0.5)
            if both.sum() >= FEWEST_PIXELS:
                found.append(images[i][both][:, :3].T @ normals[both] / both.sum())
    if found:
        yield from _axes(np.stack(found))


def _axes(M: np.ndarray) -> Iterator[Problem]:
    """Compare the ways to write a normal by M (n, 3, 3)."""
    cosines = np.stack([sum(s[i] * M[:, i, axes[i]] for i in range(3)) for axes, s in _WAYS], -1)
    mean = cosines.mean(0)
    best, plain = int(mean.argmax()), _WAYS.index(((0, 1, 2), (1, 1, 1)))
    gained = cosines[:, best] - cosines[:, plain]
    if best != plain and (gained > WORTH * (1 - cosines[:, plain])).mean() > 0.5:
        axes, signs = _WAYS[best]
        written = " ".join("-"[s > 0 :] + "xyz"[a] for a, s in zip(axes, signs, strict=True))
        figure = f"mean cosine {mean[plain]:.2f}; read as {written}: {mean[best]:.2f}"
        cause, remedy = _NAMED.get(_WAYS[best], ("axes of another program", _AXES))
        yield error("axes of the normals", figure, cause, remedy)
    elif mean[plain] < FOLLOWS:
        yield doubt("normals do not follow the body", f"mean cosine {mean[plain]:.2f}",
                    "maps of other frames, or in the world's axes", _AXES)  # fmt: skip
