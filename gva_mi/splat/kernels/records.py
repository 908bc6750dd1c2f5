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

    u: list[Array]  # 2, mean, px
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
        u0, u1, p, q, r, lo, *features = columns
        depth = features.pop() if format.depth else None
        return Splat([u0, u1], p, q, r, lo, features, depth)


@dataclass(frozen=True)
class PairGradient:
    """Contribution of one pair, or of all pairs, to a Gaussian's gradient (pixel.py, eq. 16)."""

    m0: Array | None  # None, with empty m1 and m2, if no moments are requested
    m1: list[Array]  # 2: x, y
    m2: list[Array]  # 3: xx, xy, yy
    absolute: list[Array]  # 2 absolute sums, or none
    color: list[Array]  # gradients of the features
    depth: Array | None

    @staticmethod
    def columns(format: RecordFormat) -> int:
        """Number of columns."""
        return 6 * format.moments + 2 * format.absolute + format.channels + format.depth

    def pack(self) -> list[Array]:
        """Return the columns of the record."""
        m0, depth = ([] if x is None else [x] for x in (self.m0, self.depth))
        return [*m0, *self.m1, *self.m2, *self.absolute, *self.color, *depth]

    @staticmethod
    def unpack(columns: Sequence[Array], format: RecordFormat) -> PairGradient:
        """Make the record from its columns."""
        moments, rest = columns[: 6 * format.moments], list(columns[6 * format.moments :])
        depth = rest.pop() if format.depth else None
        absolute, color = (rest[:2], rest[2:]) if format.absolute else ([], rest)
        m0 = moments[0] if format.moments else None
        return PairGradient(m0, list(moments[1:3]), list(moments[3:]), absolute, color, depth)


@dataclass(frozen=True)
class CameraGradient:
    """Contribution of one Gaussian, or of all, to the gradient by ``CameraArrays``."""

    R: list[Array]  # 9, row by row
    t: list[Array]  # 3
    f: list[Array]  # 2
    c: list[Array]  # 2
    o: list[Array]  # 3

    @staticmethod
    def columns(format: None = None) -> int:
        """Number of columns."""
        return 19

    def pack(self) -> list[Array]:
        """Return the columns of the record."""
        return [*self.R, *self.t, *self.f, *self.c, *self.o]

    @staticmethod
    def unpack(columns: Sequence[Array], format: None = None) -> CameraGradient:
        """Make the record from its columns."""
        return CameraGradient(
            columns[:9], columns[9:12], columns[12:14], columns[14:16], columns[16:]
        )
