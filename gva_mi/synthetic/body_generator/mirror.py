"""Mirror half of a surface, open at x = 0, to a closed one that is exactly symmetric.

border_of, onto_border     restore the border's outline, which decimation changes
without_chords             remove edges that the mirror image would share
mirrored                   weld both halves along the border
"""

from __future__ import annotations

import numpy as np


def border_of(faces: np.ndarray) -> np.ndarray:
    """Return the vertices of a half's open border in order, once around."""
    sides = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])
    inner = set(map(tuple, sides[:, ::-1].tolist()))
    after = {a: b for a, b in sides.tolist() if (a, b) not in inner}
    loop = [min(after)]
    while (following := after[loop[-1]]) != loop[0]:
        loop.append(following)
    if len(loop) != len(after):
        raise ValueError("border_of(): the half must have one border, without a pinch")
    return np.array(loop)


def onto_border(vertices: np.ndarray, faces: np.ndarray, outline: np.ndarray) -> np.ndarray:
    """Return vertices (V, 3) with the border of a decimated half back on its outline (S, 3).

    Decimation slides vertices along straight stretches and past each other, which folds faces. So
    they are placed on the outline, the border before decimation, in the order of the border.
    """
    moved = border_of(faces)
    start, along = outline, np.roll(outline, -1, axis=0) - outline
    t = ((vertices[moved, None] - start) * along).sum(-1) / ((along * along).sum(-1) + 1e-18)
    t = np.clip(t, 0, 1)
    gap = np.linalg.norm(vertices[moved, None] - start - t[..., None] * along, axis=-1)
    nearest = gap.argmin(1)
    length = np.linalg.norm(along, axis=1)
    before = np.concatenate([[0], np.cumsum(length)])
    place = before[nearest] + (t * length)[np.arange(len(moved)), nearest]
    # Start where the outline does, except for vertices that slid past that point.
    turn = int(np.argmin(place))
    place = np.sort(np.roll(place, -turn))
    closed = np.concatenate([outline, outline[:1]])
    vertices = vertices.copy()
    vertices[np.roll(moved, -turn)] = np.stack(
        [np.interp(place, before, closed[:, k]) for k in range(3)], axis=1
    )
    return vertices


def without_chords(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Prepare the border of a half for welding to its mirror image.

    A chord is an inner edge between two border vertices, which both halves would share. Faces with
    all corners on the border are removed; other chords get a vertex in their middle.
    """
    while True:
        edges, count = _edges(faces)
        on_border = np.isin(np.arange(len(vertices)), edges[count == 1])
        flat = on_border[faces].all(1)
        if not flat.any():
            break
        faces = faces[~flat]
    for a, b in edges[(count == 2) & on_border[edges].all(1)]:
        both = np.flatnonzero((faces == a).any(1) & (faces == b).any(1))
        middle, corners = len(vertices), np.unique(faces[both])
        vertices = np.concatenate([vertices, vertices[corners].mean(0, keepdims=True)])
        halves = [np.where(faces[both] == end, middle, faces[both]) for end in (a, b)]
        faces = np.concatenate([np.delete(faces, both, axis=0), *halves])
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[used], faces.reshape(-1, 3)


def mirrored(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weld both halves: return vertices, faces, and the mirror image of each vertex (V,)."""
    edges, count = _edges(faces)
    border = np.unique(edges[count == 1])
    inner = np.setdiff1d(np.arange(len(vertices)), border)
    vertices = vertices.copy()
    vertices[border, 0] = 0
    vertices[inner, 0] = np.maximum(vertices[inner, 0], 1e-5)
    image = np.arange(len(vertices))
    image[inner] = len(vertices) + np.arange(len(inner))
    both = np.concatenate([vertices, vertices[inner] * (-1, 1, 1)])
    return both, np.concatenate([faces, image[faces][:, ::-1]]), np.concatenate([image, inner])


def _edges(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return undirected edges (E, 2), and the number of faces of each (E,)."""
    sides = np.sort(np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)]), axis=1)
    return np.unique(sides, axis=0, return_counts=True)
