"""Rows of floats in memory, columns of floats in a kernel.

Dr.Jit reads and writes a row of 2, 4 or 8 neighbouring floats per lane in one go (a *packet*),
several times faster than as many single floats. So a record of the kernels, such as the ten floats
of a projected Gaussian, is kept as a few flat arrays whose row widths are powers of two: 10 is
8 + 2. This module holds that arithmetic; the kernels name their columns. The precision is that of
the arrays given: ``drjit.llvm.Float`` or ``Float64``.
"""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
from drjit import ArrayBase as Array
from drjit.llvm import ArrayXf, ArrayXf64, ArrayXu

Packets = list[Array]  # flat arrays of n rows each, widths as in widths()


def is_double(F: type) -> bool:
    """Whether arrays of type ``F`` hold float64."""
    return dr.type_v(F) == dr.VarType.Float64


def packet_type(F: type) -> type:
    """The dynamic array whose entries are of type ``F``: floats, or 32-bit unsigned integers."""
    if not dr.is_float_v(F):
        return ArrayXu
    return ArrayXf64 if is_double(F) else ArrayXf


def widths(columns: int) -> list[int]:
    """Powers of two, at most 8, that add up to ``columns``; largest first."""
    out = [8] * (columns // 8)
    return out + [w for w in (4, 2, 1) if columns & w]


def empty(
    F: type, columns: int, rows: int, allocate: Callable[[type, int], Array] | None = None
) -> Packets:
    """Uninitialised memory for ``rows`` records of ``columns`` floats, by :func:`memory`."""
    return [(allocate or memory)(F, w * rows) for w in widths(columns)]


def memory(F: type, size: int) -> Array:
    """Uninitialised memory for ``size`` numbers, as an argument of a frozen kernel.

    Within one it is ``dr.empty``.
    """
    array = dr.empty(F, size)
    dr.make_opaque(array)  # until then it is a promise, whose size dr.freeze takes for a constant
    return array


def load(packets: Packets, columns: int, index: Array) -> list[Array]:
    """Columns of the rows ``index``."""
    out = []
    for source, w in zip(packets, widths(columns), strict=True):
        out += load_rows(source, w, index)
    return out


def load_rows(source: Array, width: int, index: Array) -> list[Array]:
    """Columns of the rows ``index`` of one flat array of any row width."""
    F = type(source)
    if width == 1:
        return [dr.gather(F, source, index)]
    row = dr.gather(packet_type(F), source, index, shape=(width, dr.width(index)))
    return [row[k] for k in range(width)]


def store(packets: Packets, columns: list[Array], index: Array, active: Array = True) -> None:
    """Write ``columns`` to the rows ``index``; no two lanes may name the same row."""
    first = 0
    for target, w in zip(packets, widths(len(columns)), strict=True):
        store_rows(target, columns[first : first + w], index, active)
        first += w


def store_rows(target: Array, columns: list[Array], index: Array, active: Array = True) -> None:
    """Write ``columns`` to the rows ``index`` of one flat array of any row width."""
    value = columns[0] if len(columns) == 1 else packet_type(type(target))(columns)
    dr.scatter(target, value, index, active=active, mode=dr.ReduceMode.NoConflicts)
