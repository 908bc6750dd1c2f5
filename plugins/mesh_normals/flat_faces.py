"""Faces without area: they show nothing, and the edges around them are what would be without them.

A face with two corners at one place is left out. A face whose corners lie on a line may close a gap
between its longest side and the two others, as where the edge of one neighbour was split. If the
longest side has one other face ``C``, that face takes its place at the two others. ::

       C
    A ----- B            A - M - B      between C and D, and between C and E
    A - M - B
     D     E
"""

from __future__ import annotations

import numpy as np

ROUNDING = 2.0**-22  # of coordinates: a face that is no higher than this has no area


def live_sides(
    points: np.ndarray, flat: np.ndarray, places: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the sides of faces (side ``k`` of face ``f`` is ``3 f + k``) that belong to edges.

    Faces have ``points`` (F, 3) at ``places`` (V, 3); those numbered ``flat`` (n,) have no area.

    Returns:
        The points at the ends of sides in the order in which their faces run, (3F, 2); whether they
        belong to an edge, (3F,); and the faces that they are sides of, (3F,).
    """
    owner, live = np.arange(points.size) // 3, np.ones(points.size, bool)
    ends = np.stack([points, np.roll(points, -1, axis=1)], axis=2).reshape(-1, 2)
    live[(3 * flat[:, None] + np.arange(3)).ravel()] = False
    on_line = [face for face in flat.tolist() if len(set(points[face].tolist())) == 3]
    if not on_line:
        return ends, live, owner
    length = np.linalg.norm(places[ends[:, 0]] - places[ends[:, 1]], axis=1).reshape(-1, 3)
    edge = [tuple(side) for side in np.sort(ends, axis=1).tolist()]
    at: dict[tuple[int, int], list[int]] = {}  # live sides of each edge
    for side in np.flatnonzero(live).tolist():
        at.setdefault(edge[side], []).append(side)
    for face in sorted(on_line, key=lambda f: -length[f].max()):
        k = int(length[face].argmax())
        longest, *others = (3 * face + (k + j) % 3 for j in range(3))
        beyond = at.get(edge[longest], [])
        if len(beyond) != 1:
            continue
        (side,) = beyond
        live[side], at[edge[longest]] = False, []
        for other in others:
            if (ends[longest] == ends[side]).all():  # the flat face is wound the other way
                ends[other] = ends[other, ::-1]
            live[other], owner[other] = True, owner[side]
            at.setdefault(edge[other], []).append(other)
    return ends, live, owner
