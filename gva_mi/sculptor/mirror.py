"""From half of a surface, open at x = 0, to a closed one that is symmetric to the bit.

border_of → onto_border    the border gets back the outline that decimation changed
without_chords             edges go that the mirror image would have, too
mirrored                   both halves, welded along the border
"""

from __future__ import annotations

import numpy as np


def border_of(faces: np.ndarray) -> np.ndarray:
    """The vertices of a half's open border in their order, once around."""
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
    """Bring the border of a decimated half back onto the outline that it had.

    Decimation slides vertices along straight stretches, past each other too, and the faces between
    them fold. So they take their places on the outline in the order of the border.

    Args:
        vertices: (V, 3) decimated.
        faces: (F, 3)
        outline: (S, 3) closed, the border of the full half in its order.

    Returns:
        vertices, (V, 3).
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
    # Begin where the outline does, but for vertices that were slid past that point.
    turn = int(np.argmin(place))
    place = np.sort(np.roll(place, -turn))
    closed = np.concatenate([outline, outline[:1]])
    vertices = vertices.copy()
    vertices[np.roll(moved, -turn)] = np.stack(
        [np.interp(place, before, closed[:, k]) for k in range(3)], axis=1
    )
    return vertices


def without_chords(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Make the border of a half ready to be welded to its mirror image.

    A chord is an inner edge between two border vertices: its mirror image would be the same edge.
    Faces with all three corners on the border go, other chords get a vertex in their middle.
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
    """Both halves, welded along the border: vertices, faces, and the twin of each vertex (V,)."""
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
    """Edges (E, 2) without direction, and how many faces each has (E,)."""
    sides = np.sort(np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)]), axis=1)
    return np.unique(sides, axis=0, return_counts=True)
