"""Iteration over the Gaussians of a tile's list, with memory reads ahead of their use."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import drjit as dr
from drjit import ArrayBase as Array

from gva_mi.jit import packets
from gva_mi.splat.kernels.records import RecordFormat, Splat

UNSEEN = -1e30  # lo of a Gaussian that no pixel sees


@dataclass(frozen=True)
class TileIterator:
    """Iterates over a tile's list, and reads ahead.

    A Gaussian's address is known only after its id is read, and both reads are slow. So each turn
    of the loop reads the rows for the next turn and the ids for the turn after that; the loop's
    variables hold them in between.
    """

    splats: packets.Packets
    format: RecordFormat
    ids: Array
    # Index of the j-th pair after the loop's k, and whether the tile's list has it.
    place: Callable[[Array, int], tuple[Array, Array]]
    turn: int  # Gaussians per turn

    def begin(self, k: Array) -> list[Array]:
        """Read ahead for the first turn, at ``k``."""
        ids = [self._id(k, j) for j in range(2 * self.turn)]
        return [*ids[self.turn :], *self._rows(ids[: self.turn], k, 0)]

    def next(self, k: Array, ahead: Sequence[Array]) -> tuple[list[Splat], list[Array]]:
        """Return the Gaussians of the turn at ``k``, and what was read ahead for the next one."""
        ids, rows = list(ahead[: self.turn]), ahead[self.turn :]
        columns = len(rows) // self.turn
        here = [
            Splat.unpack(rows[j * columns : (j + 1) * columns], self.format)
            for j in range(self.turn)
        ]
        after = [self._id(k, 2 * self.turn + j) for j in range(self.turn)]
        return here, [*after, *self._rows(ids, k, self.turn)]

    @property
    def length(self) -> int:
        """Number of the loop's variables that hold what was read ahead."""
        return self.turn * (1 + Splat.columns(self.format))

    def _id(self, k: Array, j: int) -> Array:
        pair, inside = self.place(k, j)
        return dr.gather(type(self.ids), self.ids, pair, active=inside)

    def _rows(self, ids: list[Array], k: Array, first: int) -> list[Array]:
        """Load the columns of the Gaussians ``ids``; the first is number ``first`` after k."""
        rows = []
        for j, gaussian in enumerate(ids):
            _, inside = self.place(k, first + j)
            rows += _row(self.splats, self.format, gaussian, inside).pack()
        return rows


def load_splat(
    splats: packets.Packets, format: RecordFormat, ids: Array, k: Array, inside: Array
) -> Splat:
    """Load the Gaussian of pair ``k``; an invisible one where not ``inside`` the tile's list."""
    return _row(splats, format, dr.gather(type(ids), ids, k, active=inside), inside)


def _row(splats: packets.Packets, format: RecordFormat, gaussian: Array, inside: Array) -> Splat:
    """Load one Gaussian; an invisible one where not ``inside`` a list."""
    g = packets.load(splats, Splat, format, gaussian)
    return replace(g, lo=dr.select(inside, g.lo, UNSEEN))
