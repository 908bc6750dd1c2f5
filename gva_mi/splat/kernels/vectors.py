"""Vectors and small matrices with named entries, each entry a Dr.Jit array of one number per lane.

A matrix is a tuple of its rows: ``J.x.z`` is row x, column z. An entry may be None: a zero that
costs no instruction. Dr.Jit's own ``Array3f`` knows no such zero and is bound to one precision.

``a + b`` adds entries; ``2 * a`` and ``a * s`` scale them (``s * a`` fails where s is an array).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple, TypeVar

from drjit import ArrayBase as Array

Entry = Array | None
Entries = TypeVar("Entries", bound=tuple)


def each(function: Callable[..., Entry], first: Entries, *others: Entries) -> Entries:
    """Apply a function to the entries of vectors or matrices, place by place.

    >>> each(lambda a, b: a - b, Vec2(5, 7), Vec2(1, 2))
    Vec2(x=4, y=5)
    """
    places = zip(first, *others, strict=True)
    return type(first)(
        *(
            each(function, *place) if isinstance(place[0], tuple) else function(*place)
            for place in places
        )
    )


def plus(a: Entry, b: Entry) -> Entry:
    """Sum of two numbers, where None is zero."""
    if a is None or b is None:
        return a if b is None else b
    return a + b


def _add(a: Entries, b: Entries) -> Entries:
    return each(plus, a, b)


def _scale(a: Entries, s: Array) -> Entries:
    return each(lambda x: x * s, a)


def _scale_by_number(a: Entries, s: float) -> Entries:
    return each(lambda x: s * x, a)


class Vec2(NamedTuple):
    """A vector in the picture."""

    x: Entry
    y: Entry
    __add__, __mul__, __rmul__ = _add, _scale, _scale_by_number


class Vec3(NamedTuple):
    """A vector in space, a row of a matrix, or a colour."""

    x: Entry
    y: Entry
    z: Entry
    __add__, __mul__, __rmul__ = _add, _scale, _scale_by_number


class Quat(NamedTuple):
    """A quaternion."""

    w: Entry
    x: Entry
    y: Entry
    z: Entry
    __add__, __mul__, __rmul__ = _add, _scale, _scale_by_number


class Sym2(NamedTuple):
    """A symmetric (2, 2) matrix."""

    xx: Entry
    xy: Entry
    yy: Entry
    __add__, __mul__, __rmul__ = _add, _scale, _scale_by_number


class Sym3(NamedTuple):
    """A symmetric (3, 3) matrix."""

    xx: Entry
    xy: Entry
    xz: Entry
    yy: Entry
    yz: Entry
    zz: Entry

    def matrix(self) -> Mat3:
        """Return all nine entries."""
        xx, xy, xz, yy, yz, zz = self
        return Mat3(Vec3(xx, xy, xz), Vec3(xy, yy, yz), Vec3(xz, yz, zz))


class Mat23(NamedTuple):
    """A (2, 3) matrix: space to picture."""

    x: Vec3
    y: Vec3
    __add__, __mul__, __rmul__ = _add, _scale, _scale_by_number

    @property
    def columns(self) -> tuple[Vec2, Vec2, Vec2]:
        """The three columns."""
        return tuple(Vec2(*column) for column in zip(*self, strict=True))


class Mat3(NamedTuple):
    """A (3, 3) matrix."""

    x: Vec3
    y: Vec3
    z: Vec3
    __add__, __mul__, __rmul__ = _add, _scale, _scale_by_number

    @staticmethod
    def of(numbers: Iterable[Array]) -> Mat3:
        """Make a matrix from nine numbers, row by row."""
        a, b, c, d, e, f, g, h, i = numbers
        return Mat3(Vec3(a, b, c), Vec3(d, e, f), Vec3(g, h, i))

    def flat(self) -> list[Array]:
        """Return the nine numbers, row by row."""
        return [*self.x, *self.y, *self.z]

    @property
    def T(self) -> Mat3:
        """The transpose."""
        return Mat3(*(Vec3(*column) for column in zip(*self, strict=True)))


def dot(a: Iterable[Entry], b: Iterable[Entry]) -> Entry:
    """Sum of products of the entries of two vectors.

    >>> dot(Vec3(1, None, 2), Vec3(3, 4, 5)), dot(Vec2(1, None), Vec2(None, 2))
    (13, None)
    """
    terms = [x * y for x, y in zip(a, b, strict=True) if x is not None and y is not None]
    return sum(terms[1:], terms[0]) if terms else None


def cross(a: Vec3, b: Vec3) -> Vec3:
    """Cross product a x b."""
    return Vec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


def apply(A: Mat3, v: Vec3) -> Vec3:
    """A v."""
    return Vec3(*(dot(row, v) for row in A))


def product(A: Mat23, B: Mat3) -> Mat23:
    """A B, (2, 3)."""
    return Mat23(*(Vec3(*(dot(row, column) for column in B.T)) for row in A))


def transposed_product(A: Mat23, B: Mat23) -> Mat3:
    """A^T B, (3, 3)."""
    return Mat3(*(Vec3(*(dot(a, b) for b in B.columns)) for a in A.columns))


def symmetric_product(C: Sym2, A: Mat23) -> Mat23:
    """C A, (2, 3)."""
    return Mat23(
        each(lambda x, y: C.xx * x + C.xy * y, A.x, A.y),
        each(lambda x, y: C.xy * x + C.yy * y, A.x, A.y),
    )


def diagonal_product(A: Mat23, s: Vec3) -> Mat23:
    """A diag(s), (2, 3)."""
    return Mat23(*(each(lambda a, b: a * b, row, s) for row in A))


def outer(a: Vec3, b: Vec3) -> Mat3:
    """a b^T, (3, 3)."""
    return Mat3(*(each(lambda y, x=x: x * y, b) for x in a))
