"""Sums over segments of an array, in a fixed order.

Floating-point addition is not associative: where several threads add into one place in the order in
which they happen to arrive, the last bits differ from run to run. Here one lane owns one segment
and adds its entries from first to last, so that the same input gives the same bits on any number of
threads.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np


@dataclass(frozen=True)
class Segments:
    """Entries of S segments: segment ``i`` holds ``items[start[i]:start[i + 1]]``.

    Example:
        >>> segments = Segments.by_owner(np.array([1, 0, 1]), count=3)
        >>> segments.sum(mi.Vector3f(1, [10, 20, 30], 0)).y
        [20, 40, 0]
    """

    start: mi.UInt32  # (S + 1,)
    items: mi.UInt32  # (M,) positions in the array that is summed

    @staticmethod
    def by_owner(owner: np.ndarray, count: int) -> Segments:
        """Assign entry ``k`` to segment ``owner[k]``; entries keep their order."""
        start = np.zeros(count + 1, np.uint32)
        start[1:] = np.cumsum(np.bincount(owner, minlength=count))
        return Segments(mi.UInt32(start), mi.UInt32(np.argsort(owner, kind="stable")))

    def sum(self, values: mi.Vector3f) -> mi.Vector3f:
        """Return the sum of each segment, (S,) from values (N,)."""
        i = dr.arange(mi.UInt32, dr.width(self.start) - 1)
        first, end = (dr.gather(mi.UInt32, self.start, k) for k in (i, i + 1))
        return _sum([values], self.items, first, end)[0]


def sum_runs(values: list[mi.Vector3f], start: mi.UInt32, total: int) -> list[mi.Vector3f]:
    """Sum runs of neighbouring entries: run ``i`` ends where run ``i + 1`` starts.

    Example:
        >>> sum_runs([mi.Vector3f(1, [10, 20, 30], 0)], mi.UInt32(0, 2), 3)[0].y
        [30, 30]
    """
    return _sum(values, None, start, _ends(start, total))


def sum_by_key(values: list[mi.Vector3f], key: mi.UInt32) -> tuple[list[mi.Vector3f], mi.UInt32]:
    """Sum the entries that share a key; return sums and keys, each once, in rising order.

    Example:
        >>> sums, keys = sum_by_key([mi.Vector3f(1, [10, 20, 30], 0)], mi.UInt32(7, 4, 7))
        >>> sums[0].y, keys
        ([20, 40], [4, 7])
    """
    order = dr.argsort(key)
    key = dr.gather(mi.UInt32, key, order)
    i = dr.arange(mi.UInt32, dr.width(key))
    begins = (i == 0) | (key != dr.gather(mi.UInt32, key, i - 1, i > 0))
    start = dr.compress(begins)
    sums = _sum(values, order, start, _ends(start, dr.width(key)))
    return sums, dr.gather(mi.UInt32, key, start)


def concat(first: Sequence[dr.ArrayBase], then: Sequence[dr.ArrayBase]) -> list[dr.ArrayBase]:
    """Concatenate arrays (A,) with arrays (B,) of the same kinds, each to one (A + B,).

    Use it for arrays whose lengths vary, because ``dr.concat`` compiles a kernel for each length.

    Example:
        >>> concat([mi.Float(1, 2)], [mi.Float(3)])
        [[1, 2, 3]]
    """
    a, b = dr.width(first), dr.width(then)
    result = [dr.empty(type(x), a + b) for x in first]
    for values, index in (
        (first, dr.arange(mi.UInt32, a)),
        (then, dr.arange(mi.UInt32, b) + dr.opaque(mi.UInt32, a)),
    ):
        for target, value in zip(result, values, strict=True):
            dr.scatter(target, value, index, mode=dr.ReduceMode.NoConflicts)
        dr.eval(result)
    return result


def _ends(start: mi.UInt32, total: int) -> mi.UInt32:
    """Return the end of each run: where the next one starts."""
    i = dr.arange(mi.UInt32, dr.width(start))
    is_last = i + 1 == dr.opaque(mi.UInt32, dr.width(start))
    after = dr.gather(mi.UInt32, start, i + 1, ~is_last)
    return dr.select(is_last, dr.opaque(mi.UInt32, total), after)


@dr.syntax
def _sum(
    values: list[mi.Vector3f], items: mi.UInt32 | None, first: mi.UInt32, end: mi.UInt32
) -> list[mi.Vector3f]:
    """Sum the entries from ``first`` to ``end`` of several arrays, all in one loop."""
    k = mi.UInt32(first)
    totals = [dr.zeros(type(value), dr.width(first)) for value in values]
    while k < end:
        item = k if items is None else dr.gather(mi.UInt32, items, k)
        totals = _added(totals, values, item)
        k += 1
    return totals


def _added(
    totals: list[mi.Vector3f], values: list[mi.Vector3f], item: mi.UInt32
) -> list[mi.Vector3f]:
    return [
        total + dr.gather(type(value), value, item)
        for total, value in zip(totals, values, strict=True)
    ]
