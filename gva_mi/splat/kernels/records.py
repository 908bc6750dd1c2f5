"""Records that the kernels pass to one another through memory, with named fields.

| record | written by | read by | one for each |
|---|---|---|---|
| ``Footprint`` | ``project`` | tiles.py | Gaussian |
| ``Splat`` | ``project``, ``project_tangent`` | blend.py, in all directions | Gaussian, chunk |
| ``PairGradient`` | ``blend_adjoint`` | ``sum_slots``, for ``project_adjoint`` | pair, chunk |
| ``CameraGradient`` | ``project_adjoint`` | the host, which adds them up | Gaussian |

In memory a record is a row of floats (packets.py); in a kernel its fields are Dr.Jit arrays, one
record per lane. A *pair* is a tile and a Gaussian that touches it; a *chunk* is some channels of
the colour (chunks.py). Only ``pack`` and ``unpack`` know the order of the columns.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from drjit import ArrayBase as Array

from gva_mi.splat.kernels.vectors import Mat3, Sym2, Vec2, Vec3


@dataclass(frozen=True)
class RecordFormat:
    """The optional fields of a ``Splat`` or a ``PairGradient``."""

    channels: int  # of the colour
    depth: bool  # whether the depth is a feature too
    absolute: bool = False  # whether a slot holds the two absolute sums
    moments: bool = True  # whether a slot holds the moments of eq. 16


@dataclass(frozen=True)
class Footprint:
    """The ellipse in the picture where alpha >= alpha_min (ellipse.py, eq. 7); px."""

    u: Array  # mean
    v: Array
    rx: Array  # half extents; ry < 0 where nothing is to be drawn
    ry: Array
    shear: Array  # at height d_y the columns are shear d_y -+ half sqrt(1 - (d_y / ry)^2)
    half: Array
    turn: Array  # d_y of the rightmost point; the leftmost lies at -turn

    @staticmethod
    def columns(format: None = None) -> int:
        """Number of columns: the fields, and one that fills up the packet."""
        return 8

    def pack(self) -> list[Array]:
        """Return the columns of the record."""
        fields = [self.u, self.v, self.rx, self.ry, self.shear, self.half, self.turn]
        return [*fields, self.u]

    @staticmethod
    def unpack(columns: Sequence[Array], format: None = None) -> Footprint:
        """Make the record from its columns."""
        return Footprint(*columns[:7])


@dataclass(frozen=True)
class Splat:
    """A projected Gaussian: mean, ellipse and opacity (lens.py, ellipse.py), and features."""

    u: Vec2  # mean, px
    p: Array  # eq. 6
    q: Array
    r: Array
    lo: Array  # eq. 7
    color: list[Array]
    depth: Array | None

    @property
    def features(self) -> list[Array]:
        """f of eq. 14: the channels of the colour and, if composited, the depth."""
        return self.color if self.depth is None else [*self.color, self.depth]

    @staticmethod
    def columns(format: RecordFormat) -> int:
        """Number of columns."""
        return 6 + format.channels + format.depth

    def pack(self) -> list[Array]:
        """Return the columns of the record."""
        return [*self.u, self.p, self.q, self.r, self.lo, *self.features]

    @staticmethod
    def unpack(columns: Sequence[Array], format: RecordFormat) -> Splat:
        """Make the record from its columns."""
        ux, uy, p, q, r, lo, *features = columns
        depth = features.pop() if format.depth else None
        return Splat(Vec2(ux, uy), p, q, r, lo, features, depth)


@dataclass(frozen=True)
class PairGradient:
    """Contribution of one pair, or of all pairs, to a Gaussian's gradient (pixel.py, eq. 16)."""

    m0: Array | None  # None, as m1 and m2, if no moments are requested
    m1: Vec2 | None
    m2: Sym2 | None
    absolute: Vec2 | None  # the absolute sums
    color: list[Array]  # gradients of the features
    depth: Array | None

    @staticmethod
    def columns(format: RecordFormat) -> int:
        """Number of columns."""
        return 6 * format.moments + 2 * format.absolute + format.channels + format.depth

    def pack(self) -> list[Array]:
        """Return the columns of the record."""
        moments = [] if self.m0 is None else [self.m0, *self.m1, *self.m2]
        depth = [] if self.depth is None else [self.depth]
        return [*moments, *(self.absolute or ()), *self.color, *depth]

    @staticmethod
    def unpack(columns: Sequence[Array], format: RecordFormat) -> PairGradient:
        """Make the record from its columns."""
        rest = list(columns)
        m0 = m1 = m2 = absolute = None
        if format.moments:
            m0, mx, my, mxx, mxy, myy, *rest = rest
            m1, m2 = Vec2(mx, my), Sym2(mxx, mxy, myy)
        if format.absolute:
            ax, ay, *rest = rest
            absolute = Vec2(ax, ay)
        depth = rest.pop() if format.depth else None
        return PairGradient(m0, m1, m2, absolute, rest, depth)


@dataclass(frozen=True)
class CameraGradient:
    """Contribution of one Gaussian, or of all, to the gradient with respect to ``CameraArrays``."""

    R: Mat3
    t: Vec3
    f: Vec2
    c: Vec2
    o: Vec3

    @staticmethod
    def columns(format: None = None) -> int:
        """Number of columns."""
        return 19

    def pack(self) -> list[Array]:
        """Return the columns of the record."""
        return [*self.R.flat(), *self.t, *self.f, *self.c, *self.o]

    @staticmethod
    def unpack(columns: Sequence[Array], format: None = None) -> CameraGradient:
        """Make the record from its columns."""
        R, t, f, c, o = (columns[i:j] for i, j in ((0, 9), (9, 12), (12, 14), (14, 16), (16, 19)))
        return CameraGradient(Mat3.of(R), Vec3(*t), Vec2(*f), Vec2(*c), Vec3(*o))
