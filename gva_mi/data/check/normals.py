"""The axes of the normals: which of them, and with which sign, the body's own normals have.

With n the normals of a map and b those of the body, in the camera's axes, over the N pixels that
both show,

    1. M = Σ b nᵀ / N
    2. mean cos of b and S n = Σ_i s_i M[i, π(i)]      for n with axes π exchanged, and signs s

so that the best of all 48 ways to write a normal follows from nine sums. The plain one has to be
the best, up to chance: its loss to the best must be a quarter of what it lacks, in most frames.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from gva_mi.core.errors import InputError
from gva_mi.data.check.findings import Finding
from gva_mi.data.check.seen import Seen
from gva_mi.data.normals import NormalMaps
from gva_mi.splat import Camera

FEWEST_PIXELS = 50  # of a frame: fewer say nothing about three axes
KNOWN = 0.5  # of a mask's pixels that should have a normal
FOLLOWS = 0.5  # mean cosine: 60 degrees. Of hemispheres that have nothing in common it is 0.5, for
# all that is seen faces the camera: less, and the maps do not show this body.
WORTH = 0.25
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
    maps: NormalMaps, some: Seen, images: np.ndarray, cameras: dict[int, Camera]
) -> Iterator[Finding]:
    """Findings about the maps.

    Args:
        maps: of the folder.
        some: n frames, as they are seen.
        images: (n, h, w, 4) the body's normals and silhouette.
        cameras: of the frames as large as they are, by number.
    """
    found, unknown = [], []
    for i, frame in enumerate(some.frames):
        try:
            normals = maps.read(frame, cameras[frame])
        except InputError:  # said where the maps were opened
            continue
        if normals is None:
            continue
        normals = _sampled(normals, some.masks.shape[1:])
        known = (normals != 0).any(-1) & some.masks[i]
        if known.sum() < KNOWN * some.masks[i].sum():
            unknown.append((frame, known.sum() / max(1, some.masks[i].sum())))
        both = known & (images[i, ..., 3] > 0.5)
        if both.sum() >= FEWEST_PIXELS:
            found.append(images[i][both][:, :3].T @ normals[both] / both.sum())
    if unknown:
        yield Finding(
            "doubtful", "few normals", f"known in {100 * unknown[0][1]:.0f} % of a mask",
            "vectors that are not of unit length, another encoding, or maps of another crop",
            "(n + 1) / 2 in 8-bit PNG, or floating point in .npy", tuple(f for f, _ in unknown),
        )  # fmt: skip
    if found:
        yield from _axes(np.stack(found))


def cosines(M: np.ndarray) -> np.ndarray:
    """The mean cosine of each of the 48 ways (eq. 2), (..., 48) of M (..., 3, 3)."""
    rows = range(3)
    return np.stack(
        [sum(s[i] * M[..., i, axes[i]] for i in rows) for axes, s in _WAYS], axis=-1
    )  # fmt: skip


def _axes(M: np.ndarray) -> Iterator[Finding]:
    """Of M (n, 3, 3)."""
    each = cosines(M)
    mean = each.mean(0)
    best, plain = int(mean.argmax()), _WAYS.index(((0, 1, 2), (1, 1, 1)))
    gained = each[:, best] - each[:, plain]
    if best != plain and (gained > WORTH * (1 - each[:, plain])).mean() > 0.5:
        axes, signs = _WAYS[best]
        written = " ".join(
            f"{'-' if s < 0 else ''}{'xyz'[a]}" for a, s in zip(axes, signs, strict=True)
        )
        cause, remedy = _NAMED.get(_WAYS[best], ("axes of another program", "x right, y down, z "
                                                 "forward, (n + 1) / 2 in PNG"))  # fmt: skip
        yield Finding(
            "error", "axes of the normals",
            f"mean cosine with the body's {mean[plain]:.2f}; read as {written}: {mean[best]:.2f}",
            cause, remedy,
        )  # fmt: skip
    elif mean[plain] < FOLLOWS:
        yield Finding(
            "doubtful", "normals do not follow the body", f"mean cosine {mean[plain]:.2f}",
            "maps of other frames, or in the world's axes", "camera space: x right, y down, z "
            "forward",
        )  # fmt: skip


def _sampled(normals: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Normals (H, W, 3) at the middles of the pixels of a smaller picture (h, w)."""
    rows, columns = (
        ((np.arange(n) + 0.5) * total / n).astype(int)
        for n, total in zip(size, normals.shape[:2], strict=True)
    )
    return normals[rows[:, None], columns[None]]
