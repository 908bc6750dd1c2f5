"""Measure the times of calls, singly or in turn, and print them as tables."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import drjit as dr

from gva_mi.core.console import aligned

WARM_UP = 2  # calls before the first that counts; chosen: they compile and allocate


@dataclass(frozen=True)
class Timing:
    """The duration of repeated calls."""

    minimum: float  # ms
    median: float  # ms

    @staticmethod
    def of(milliseconds: Sequence[float]) -> Timing:
        """Summarise the time of each call."""
        return Timing(min(milliseconds), statistics.median(milliseconds))

    @property
    def columns(self) -> dict[str, float]:
        """Return the cells of a table row."""
        return {"min ms": self.minimum, "median ms": self.median}


@dataclass(frozen=True)
class Table:
    """Rows of figures under a title; the first row's keys are the columns."""

    title: str
    rows: list[dict[str, str | float | int]] = field(default_factory=list)

    def __str__(self) -> str:
        cells = [list(self.rows[0]), *([_cell(v) for v in row.values()] for row in self.rows)]
        texts = [k for k, value in enumerate(self.rows[0].values()) if isinstance(value, str)]
        return "\n".join([f"{self.title}:", *aligned(cells, texts)])


class Clock:
    """Measure the milliseconds of each block ``with clock(name)``, by name."""

    def __init__(self) -> None:
        self.times: dict[str, list[float]] = {}

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Time one piece of work, up to the end of its kernels."""
        start = time.perf_counter()
        yield
        dr.sync_thread()
        self.times.setdefault(name, []).append(1e3 * (time.perf_counter() - start))

    def table(self, title: str, warm_up: int = 0) -> Table:
        """Return the times of all names, without the first calls of each."""
        rows = [{"": k} | Timing.of(t[warm_up:]).columns for k, t in self.times.items()]
        return Table(title, rows)


def timed(call: Callable[[], object], repeats: int) -> Timing:
    """Time repeated calls."""
    clock = Clock()
    for _ in range(WARM_UP + repeats):
        with clock("call"):
            call()
    return Timing.of(clock.times["call"][WARM_UP:])


def by_turns(title: str, ways: dict[str, Callable[[], object]], calls: int) -> Table:
    """Time several ways in turn, so that the machine's other work falls on all of them.

    The ratio is the median over the rounds of a way's time and the first way's.
    """
    clock = Clock()
    for _ in range(WARM_UP + calls):
        for name, way in ways.items():
            with clock(name):
                way()
    table = clock.table(title, WARM_UP)
    first, *_ = clock.times.values()
    for row, own in zip(table.rows, clock.times.values(), strict=True):
        ratios = [a / b for a, b in zip(own[WARM_UP:], first[WARM_UP:], strict=True)]
        row["ratio"] = statistics.median(ratios)
    return table


def _cell(value: str | float) -> str:
    if isinstance(value, float):
        return f"{value:.2f}" if abs(value) >= 0.01 or value == 0 else f"{value:.1e}"
    return value if isinstance(value, str) else f"{value:,}"
