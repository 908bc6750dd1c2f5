"""Reference for the boundary part of an image's derivative, exact on lines across the image.

On a line of the image a triangle is a segment. With a nearness that is affine on the image of a
plane (one over the depth, for a pinhole) the line shows the upper envelope of these segments. It is
computed in float64 without rays or steps: contours may lie arbitrarily close to one another.

1. **Breakpoints**: the envelope passes from one triangle to another at the end of a segment, which
   lies on an edge, or where two segments cross, in the line where two triangles intersect.
   Contours, creases and lines of intersection are treated alike.
2. **Speed**: a breakpoint is a zero of a function ``φ(q)`` affine on the image: the signed distance
   from an edge, or the difference of two triangles' nearness. As vertices move by ``ε``, its curve
   moves along ``m = ∇φ / |∇φ|`` with the speed ``v = -∂φ/∂ε / |∇φ|``.
3. **Boundary**: ``∂I/∂ε = ∫ (I_- - I_+) v dℓ`` along all curves, ``m`` pointing from - to +.
4. **Lines**: rows ``Δ`` apart meet a piece ``dℓ`` with the density ``|m_x| / Δ``, columns with
   ``|m_y| / Δ``. Weighted by ``m_x²`` and ``m_y²``, a breakpoint counts ``Δ |m_x|`` or ``Δ |m_y|``,
   and rows or columns meet every curve. Only the lines are sampled.

Eq. 3 is the boundary term of Reynolds' transport theorem; its evaluation on lines is ours.

Nothing is shared with ``mesh_normals``. Images have a box filter and five channels, (H, W, 5):
normal in camera space, mask, depth.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from gva_mi.gradcheck.moving_mesh import MovingMesh, PinholeLens

# ε of the central differences ∂φ/∂ε, a share of the motion. Chosen for float64: φ is nearly affine.
DIFFERENCE_STEP = 1e-6
# Pixels: shorter segments are left out. Chosen: float64's spacing of pixel positions is 1e-13.
SHORTEST_SEGMENT = 1e-12
# Share of a stretch up to which two segments cross in its end. Chosen: above float64's rounding.
END_SHARE = 1e-9


@dataclass(frozen=True)
class _Breakpoints:
    """Points where the envelopes of lines pass from one triangle to another."""

    q: np.ndarray  # (S, 2) pixels
    runs: np.ndarray  # (S,) the coordinate that runs along the line: 0 a row, 1 a column
    before: np.ndarray  # (S,) the visible triangle before it on the line, or -1
    after: np.ndarray  # (S,) the visible triangle after it, or -1
    on_edge: np.ndarray  # (S,) bool: on an edge; else on a line of intersection
    pair: np.ndarray  # (S, 2) the vertices of the edge, or the two triangles


def boundary(
    mesh: MovingMesh, lens: PinholeLens, lines: int, generator: np.random.Generator
) -> np.ndarray:
    """Return the part of the image's derivative that visibility changes cause (eq. 3), (H, W, 5).

    Args:
        mesh: with its motion.
        lens: of the camera.
        lines: rows and columns together, over the rectangle in which something moves.
        generator: places each line in a stripe of its own.

    Raises:
        ValueError: part of the mesh lies beside or behind the camera.

    Example:
        >>> from gva_mi.splat import Camera, look_at
        >>> camera = Camera(16.0, 16.0, 8.0, 8.0, look_at((2, 2, 2), (0, 0, 0)), 16, 16)
        >>> mesh = MovingMesh(np.eye(3), np.array([[0, 1, 2]]), np.ones((3, 3)))
        >>> change = boundary(mesh, PinholeLens(camera), 2000, np.random.default_rng(0))
        >>> mask = change[..., 3].sum()  # the triangle of √3/2 m² comes nearer: its area grows
        >>> depth = np.sqrt(12) - np.sqrt(1 / 3)  # of area = √3/2 (16 / depth)², by -√3 m
        >>> exact = np.sqrt(3) / 2 * 16**2 * 2 / depth**3 * np.sqrt(3)
        >>> bool(abs(mask / exact - 1) < 0.01)
        True
    """
    flat = _FlatMesh.of(mesh, lens)
    low, high = mesh.window(lens, 0.0)
    near = flat.within(low, high)
    spacing = (high - low).sum() / lines
    found = []
    for runs in (0, 1):
        first, last = low[1 - runs], high[1 - runs]
        count = max(round((last - first) / spacing), 1)
        places = first + (np.arange(count) + generator.random(count)) * (last - first) / count
        found += [flat.breakpoints(near, runs, place) for place in places]
    parts = [x for x in found if x is not None]
    image = np.zeros((math.prod(lens.size), 5))
    if parts:
        names = _Breakpoints.__dataclass_fields__
        points = _Breakpoints(*(np.concatenate([getattr(x, n) for x in parts]) for n in names))
        change = flat.change(points) * spacing
        inside = ((points.q >= 0) & (points.q < lens.size)).all(1)
        np.add.at(image, points.q[inside].astype(np.int64) @ [1, lens.size[0]], change[inside])
    return image.reshape(*lens.size[::-1], 5)


@dataclass(frozen=True)
class _FlatMesh:
    """A mesh projected to the image: now, and a tiny step of its motion before and after."""

    faces: np.ndarray  # (F, 3)
    q: tuple[np.ndarray, np.ndarray, np.ndarray]  # (V, 2) pixels: now, after, before
    nearness: tuple[np.ndarray, np.ndarray, np.ndarray]  # (V,): now, after, before
    depth: np.ndarray  # (V,)
    normals: np.ndarray  # (F, 3, 3) unit, camera space

    @staticmethod
    def of(mesh: MovingMesh, lens: PinholeLens) -> _FlatMesh:
        now, after, before = (mesh.at(step) for step in (0.0, DIFFERENCE_STEP, -DIFFERENCE_STEP))
        if lens.depth(now).min() <= 0:
            raise ValueError("scanlines: every vertex must lie before the camera")
        return _FlatMesh(
            mesh.faces,
            tuple(lens.project(x) for x in (now, after, before)),
            tuple(lens.nearness(x) for x in (now, after, before)),
            lens.depth(now),
            mesh.corner_normals(0.0) @ lens.rotation,
        )

    def within(self, low: np.ndarray, high: np.ndarray) -> np.ndarray:
        """Return the numbers of the triangles whose box meets a rectangle."""
        corners = self.q[0][self.faces]
        return np.flatnonzero(((corners.max(1) >= low) & (corners.min(1) <= high)).all(1))

    def breakpoints(self, near: np.ndarray, runs: int, place: float) -> _Breakpoints | None:
        """Find the breakpoints of one line (eq. 1); None if it meets no triangle.

        Args:
            near: numbers of the triangles to test.
            runs: the coordinate that runs along the line.
            place: the other coordinate.
        """
        along, across = self.q[0][:, runs], self.q[0][:, 1 - runs]
        beyond = across > place
        met = beyond[self.faces[near]]
        face = near[met.any(1) & ~met.all(1)]
        # Sides from the lower to the higher vertex, so that two triangles that share a side meet
        # the line in the very same point.
        side = np.sort(np.stack([self.faces[face], np.roll(self.faces[face], -1, 1)], 2), axis=2)
        met = beyond[side[..., 0]] != beyond[side[..., 1]]  # two sides of each triangle
        a, b = side[met].reshape(-1, 2, 2).transpose(2, 0, 1)
        t = (place - across[a]) / (across[b] - across[a])
        x = along[a] + t * (along[b] - along[a])
        u = self.nearness[0][a] + t * (self.nearness[0][b] - self.nearness[0][a])
        turned = np.argsort(x, axis=1)
        x, u, a, b = (np.take_along_axis(v, turned, 1) for v in (x, u, a, b))
        long = x[:, 1] - x[:, 0] > SHORTEST_SEGMENT
        face, x, u, a, b = (v[long] for v in (face, x, u, a, b))
        if len(face) == 0:
            return None
        starts, owners = upper_envelope(x, u)
        owners = np.concatenate([[-1], owners, [-1]])
        changes = np.flatnonzero(np.diff(owners))
        at, left, right = starts[changes], owners[changes], owners[changes + 1]
        ends = (left >= 0) & (x[left, 1] == at)
        begins = ~ends & (right >= 0) & (x[right, 0] == at)
        owner, end = np.where(ends, left, right), np.where(ends, 1, 0)
        on_edge = ends | begins
        pair = np.where(
            on_edge[:, None],
            np.stack([a[owner, end], b[owner, end]], 1),
            np.stack([face[left], face[right]], 1),
        )
        q = np.full((len(at), 2), place)
        q[:, runs] = at
        before, after = (np.where(k >= 0, face[k], -1) for k in (left, right))
        return _Breakpoints(q, np.full(len(at), runs), before, after, on_edge, pair)

    def change(self, points: _Breakpoints) -> np.ndarray:
        """Return the contribution of each breakpoint to its pixel (eq. 3, 4), (S, 5), for Δ = 1."""
        gradient = self._level(points, 0)[1]
        d_level = (self._level(points, 1)[0] - self._level(points, 2)[0]) / (2 * DIFFERENCE_STEP)
        length = np.linalg.norm(gradient, axis=1)
        m = np.take_along_axis(gradient, points.runs[:, None], 1)[:, 0] / length
        jump = self._shade(points.before, points.q) - self._shade(points.after, points.q)
        return jump * (-d_level / length * m)[:, None]

    def _level(self, points: _Breakpoints, which: int) -> tuple[np.ndarray, np.ndarray]:
        """Return φ (S,) of eq. 2 and its gradient (S, 2); ``which``: 0 now, 1 after, 2 before."""
        level, gradient = np.zeros(len(points.q)), np.zeros((len(points.q), 2))
        on, q = points.on_edge, self.q[which]
        a, b = q[points.pair[on]].transpose(1, 0, 2)
        gradient[on] = (b - a)[:, ::-1] * [-1, 1]
        level[on] = (gradient[on] * (points.q[on] - a)).sum(1)
        for sign, face in zip((1, -1), points.pair[~on].T, strict=True):
            corner, u = q[self.faces[face]], self.nearness[which][self.faces[face]]
            sides = corner[:, 1:] - corner[:, :1]
            slope = np.linalg.solve(sides, (u[:, 1:] - u[:, :1])[..., None])[..., 0]
            gradient[~on] += sign * slope
            level[~on] += sign * (u[:, 0] + (slope * (points.q[~on] - corner[:, 0])).sum(1))
        return level, gradient

    def _shade(self, face: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Return normal, mask and depth (S, 5) of triangles at pixels; zero for none."""
        seen = face >= 0
        values = np.zeros((len(face), 5))
        face, q = face[seen], q[seen]
        vertex = self.faces[face]
        corner = self.q[0][vertex]
        sides = (corner[:, 1:] - corner[:, :1]).transpose(0, 2, 1)
        b = np.linalg.solve(sides, (q - corner[:, 0])[..., None])[..., 0]
        b = np.column_stack([1 - b.sum(1), b]) / self.depth[vertex]
        b /= b.sum(1, keepdims=True)
        n = np.einsum("sk,skc->sc", b, self.normals[face])
        n /= np.linalg.norm(n, axis=1, keepdims=True)
        depth = (b * self.depth[vertex]).sum(1)
        values[seen] = np.column_stack([n, np.ones(len(n)), depth])
        return values


@dataclass(frozen=True)
class _Segments:
    """Segments of straight lines over an axis."""

    x: np.ndarray  # (N,) where each begins
    u: np.ndarray  # (N,) its height there
    slope: np.ndarray  # (N,)

    def height(self, k: np.ndarray, at: np.ndarray) -> np.ndarray:
        """Return the heights of segments ``k`` at some places."""
        return self.u[k] + self.slope[k] * (at - self.x[k])

    def highest_between(
        self, candidates: np.ndarray, l: float, A: int, r: float, B: int, short: float
    ) -> Iterator[tuple[float, int]]:
        """Find the highest candidates from ``l`` to ``r``: where each begins, and which it is.

        ``A`` is the highest at ``l``, ``B`` at ``r``. Stretches below ``short`` are left out.
        """
        if A == B:
            yield l, A
            return
        at = l - (self.height(A, l) - self.height(B, l)) / (self.slope[A] - self.slope[B])
        if not at > l + short:
            yield l, B
        elif at >= r - short:
            yield l, A
        else:
            C = candidates[self.height(candidates, at).argmax()]
            if C in (A, B) or self.height(C, at) <= self.height(A, at):
                yield l, A
                yield at, B
            else:
                yield from self.highest_between(candidates, l, A, at, C, short)
                yield from self.highest_between(candidates, at, C, r, B, short)


def upper_envelope(x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find the highest segment at every place of a line.

    Args:
        x: (N, 2) where each segment begins and ends, in rising order.
        u: (N, 2) its heights there.

    Returns:
        Where stretches begin, and where the last one ends, (M + 1,); and the highest segment on
        each stretch, (M,), -1 for none.

    Example:
        >>> upper_envelope(np.array([[0.0, 2.0], [1.0, 3.0]]), np.array([[0.0, 2.0], [1.5, 0.5]]))
        (array([0.        , 1.        , 1.33333333, 2.        , 3.        ]), array([0, 1, 0, 1]))
    """
    segments = _Segments(x[:, 0], u[:, 0], (u[:, 1] - u[:, 0]) / (x[:, 1] - x[:, 0]))
    ends, place = np.unique(x, return_inverse=True)
    a, b = ends[:-1], ends[1:]
    over, stretch = _pairs_by_stretch(place.reshape(-1, 2))
    bounds = np.searchsorted(stretch, np.arange(len(a) + 1))
    covered = bounds[1:] > bounds[:-1]
    first, last = np.full((2, len(a)), -1)
    for winner, at in ((first, a), (last, b)):
        rising = np.lexsort((segments.height(over, at[stretch]), stretch))
        winner[covered] = over[rising[bounds[1:][covered] - 1]]
    highest = first.copy()

    # A segment that is highest at both ends of a stretch is highest on all of it.
    starts, owners = [], []
    for k in np.flatnonzero(first != last):
        candidates = over[bounds[k] : bounds[k + 1]]
        short = END_SHARE * (b[k] - a[k])
        for at, owner in segments.highest_between(candidates, a[k], first[k], b[k], last[k], short):
            if at == a[k]:
                highest[k] = owner
            else:
                starts.append(at)
                owners.append(owner)
    starts, owners = np.array([*a, *starts]), np.array([*highest, *owners])
    order = np.argsort(starts, kind="stable")
    return np.append(starts[order], ends[-1]), owners[order].astype(np.int64)


def _pairs_by_stretch(places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return all pairs of a segment and a stretch that it covers, ordered by stretch: (P,), (P,).

    Args:
        places: (N, 2) numbers of the places at which each segment begins and ends.
    """
    count = places[:, 1] - places[:, 0]
    over = np.repeat(np.arange(len(places)), count)
    stretch = np.arange(len(over)) + np.repeat(places[:, 0] - np.cumsum(count) + count, count)
    by_stretch = np.argsort(stretch, kind="stable")
    return over[by_stretch], stretch[by_stretch]
