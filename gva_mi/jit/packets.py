"""Records in a kernel, stored in memory as rows of floats.

Dr.Jit reads and writes a row of 2, 4 or 8 neighbouring floats per lane in one go (a *packet*),
several times faster than as many single floats. So a record of the kernels (records.py), such as
the ten floats of a projected Gaussian, is stored as a few flat arrays whose row widths are powers
of two: 10 is 8 + 2. This module holds that arithmetic; the records know the order of their columns.
The precision is that of the arrays given: ``drjit.llvm.Float`` or ``Float64``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

import drjit as dr
from drjit import ArrayBase as Array
from drjit.llvm import ArrayXf, ArrayXf64, ArrayXu

Packets = list[Array]  # flat arrays of n rows each, widths as in widths()


R = TypeVar("R")  # a record: columns(format) counts its floats, pack() returns, unpack() reads them


def is_double(F: type) -> bool:
    """Whether arrays of type ``F`` hold float64."""
    return dr.type_v(F) == dr.VarType.Float64


def packet_type(F: type) -> type:
    """Return the dynamic array type with entries of type ``F``: floats, or unsigned integers."""
    if not dr.is_float_v(F):
        return ArrayXu
    return ArrayXf64 if is_double(F) else ArrayXf


def widths(columns: int) -> list[int]:
    """Split ``columns`` into powers of two, at most 8; largest first."""
    out = [8] * (columns // 8)
    return out + [w for w in (4, 2, 1) if columns & w]


def memory(F: type, size: int) -> Array:
    """Allocate ``size`` numbers, uninitialised, as an argument of a frozen kernel.

    Inside a frozen kernel memory is allocated by ``dr.empty``.
    """
    array = dr.empty(F, size)
    dr.make_opaque(array)  # before it has only a size, which dr.freeze takes for a constant
    return array


def empty(
    kind: type[R],
    format: Any,  # noqa: ANN401
    rows: int,
    F: type,
) -> Packets:
    """Allocate ``rows`` records of a kind, of numbers of type ``F``, inside a frozen kernel."""
    return [dr.empty(F, width * rows) for width in widths(kind.columns(format))]


def load(source: Packets, kind: type[R], format: Any, index: Array) -> R:  # noqa: ANN401
    """Load the records in the rows ``index``."""
    columns = []
    for packet, width in zip(source, widths(kind.columns(format)), strict=True):
        columns += load_rows(packet, width, index)
    return kind.unpack(columns, format)


def store(target: Packets, record: R, index: Array, active: Array = True) -> None:
    """Store records to the rows ``index``; no two lanes may name the same row."""
    columns, first = record.pack(), 0
    for packet, width in zip(target, widths(len(columns)), strict=True):
        store_rows(packet, columns[first : first + width], index, active)
        first += width


def load_rows(source: Array, width: int, index: Array) -> list[Array]:
    """Load the rows ``index`` of one flat array of any row width."""
    F = type(source)
    if width == 1:
        return [dr.gather(F, source, index)]
    row = dr.gather(packet_type(F), source, index, shape=(width, dr.width(index)))
    return [row[k] for k in range(width)]


def store_rows(target: Array, numbers: Sequence[Array], index: Array, active: Array = True) -> None:
    """Store to the rows ``index`` of one flat array of any row width."""
    value = numbers[0] if len(numbers) == 1 else packet_type(type(target))(numbers)
    dr.scatter(target, value, index, active=active, mode=dr.ReduceMode.NoConflicts)
