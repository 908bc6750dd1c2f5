"""Eq. 16 (pixel.py): sums over the pixels of a pair (tile, Gaussian), then over the pairs."""

from __future__ import annotations

import drjit as dr
from drjit import ArrayBase as Array

from gva_mi.jit import packets
from gva_mi.splat.kernels.pixel import PLACES, Alpha, PixelRow
from gva_mi.splat.kernels.records import PairGradient, RecordFormat, Splat
from gva_mi.splat.kernels.tiles import WIDTH, Lists


class PairGradientSums:
    """Accumulates eq. 16 of one pair over the tile's pixels; None is a zero."""

    def __init__(self, format: RecordFormat) -> None:
        self.m0: Array | None = None
        self.m1: list[Array | None] = [None] * (2 * format.moments)
        self.m2: list[Array | None] = [None] * (3 * format.moments)
        self.absolute: list[Array | None] = [None] * (2 * format.absolute)
        self.grad_f: list[Array | None] = [None] * (format.channels + format.depth)
        self.format = format

    def add_pixel(self, g: Splat, alpha: Alpha, v: Array, weight: Array, by_y: list[Array]) -> None:
        """Add one pixel's share of grad_f and of the absolute sums."""
        channels, depth = self.format.channels, self.format.depth
        for c, by_feature in enumerate([*by_y[:channels], *by_y[len(by_y) - depth :]]):
            self.grad_f[c] = _fma(weight, by_feature, self.grad_f[c])
        if self.absolute:
            ax, ay = self.absolute
            by_v = g.q * alpha.wx + g.r * alpha.wy
            self.absolute = [_add(ax, dr.abs(v * alpha.wx)), _add(ay, dr.abs(v * by_v))]

    def add_row(self, row: PixelRow, v: list[Array]) -> None:
        """Add the moments of a row of pixels, from s_n = sum v e^n about the row's middle.

        Pixels at e and -e share a product.
        """
        s0 = s1 = s2 = None
        for left in range(WIDTH // 2):
            e = -PLACES[left]
            both, difference = v[left] + v[WIDTH - 1 - left], v[WIDTH - 1 - left] - v[left]
            s0, s1, s2 = _add(s0, both), _fma(difference, e, s1), _fma(both, e * e, s2)
        ps1, vy = row.p * s1, s0 * row.wy
        sx = dr.fma(row.middle, s0, ps1)  # sum v w_x
        self.m0 = _add(self.m0, s0)
        self.m1 = [_add(self.m1[0], sx), _add(self.m1[1], vy)]
        self.m2 = [
            _add(self.m2[0], dr.fma(row.middle, sx + ps1, row.p * row.p * s2)),
            _fma(sx, row.wy, self.m2[1]),
            _fma(vy, row.wy, self.m2[2]),
        ]

    def slot(self) -> PairGradient:
        """Return the sums as a record."""
        color = self.grad_f[: self.format.channels]
        depth = self.grad_f[-1] if self.format.depth else None
        return PairGradient(self.m0, self.m1, self.m2, self.absolute, color, depth)


def sum_slots(
    lists: Lists,
    places: Array,
    slots: packets.Packets,
    format: RecordFormat,
    sums: packets.Packets,
) -> None:
    """Add up each Gaussian's slots, one after the other, and store them in its row of ``sums``.

    Lanes are Gaussians in the order of emission, so that a packet reads ``lists.places`` in order.
    """
    zero = dr.zeros(type(slots[0]), dr.width(lists.order))

    def body(k: Array, *total: Array) -> tuple[Array, ...]:
        pair = dr.gather(type(k), places, k)
        slot = packets.load(slots, PairGradient, format, pair).pack()
        return (k + 1, *(a + b for a, b in zip(total, slot, strict=True)))

    last = lists.first + lists.counts
    zeros = (zero * 1 for _ in range(PairGradient.columns(format)))
    state = (type(lists.first)(lists.first), *zeros)
    state = dr.while_loop(state, lambda k, *_: k < last, body, mode="symbolic", compress=False)
    packets.store(sums, PairGradient.unpack(state[1:], format), lists.order)


def _add(a: Array | None, b: Array) -> Array:
    return b if a is None else a + b


def _fma(a: Array, b: Array, c: Array | None) -> Array:
    return a * b if c is None else dr.fma(a, b, c)
