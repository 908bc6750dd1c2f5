"""Console output: its streams, a progress bar with figures, lines above it, lists of frames."""

from __future__ import annotations

import os
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from typing import Protocol


def complete_streams() -> None:
    """Make the streams of this process accept any text, and open closed ones.

    A process that was started with ``>&-`` has no ``sys.stdout``, and the first file that it opens
    gets that number: what a library prints would be written into that file.
    """
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(number)
    sys.stdout = sys.stdout or open(os.devnull, "w")  # noqa: SIM115 (as long as the process)
    sys.stderr = sys.stderr or open(os.devnull, "w")  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, AttributeError):  # a notebook's stream, or one that began elsewhere
            stream.reconfigure(errors="backslashreplace")


def discard_what_is_unread() -> None:
    """Discard output whose reader has closed its end, so that Python's last flush succeeds."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


class Progress(Protocol):
    """The function that long work calls to report progress."""

    def __call__(self, done: int, total: int, **figures: float) -> None:
        """Report ``done`` of ``total`` units, and the latest values worth showing."""


_FORM = (
    "{desc:<9}{percentage:3.0f}% {bar:24} {n_fmt}/{total_fmt} [{elapsed} < {remaining}]{postfix}"
)


@contextmanager
def bar(step: str) -> Iterator[Progress]:
    """Show a progress bar: the step, its share, the time left, and its latest figures."""
    from tqdm import tqdm

    with tqdm(desc=step, bar_format=_FORM, dynamic_ncols=True, mininterval=0.5) as shown:

        def progress(done: int, total: int, **figures: float) -> None:
            shown.total = total
            shown.set_postfix(figures, refresh=False)
            shown.update(done - shown.n)

        yield progress


def say(line: str) -> None:
    """Print a line above the progress bar."""
    from tqdm import tqdm

    tqdm.write(line)


def part_of_progress(
    progress: Progress | None, before: int, steps: int, total: int
) -> Progress | None:
    """Return a progress function for a part of longer work, or None if nothing is reported.

    The part counts for ``steps`` of all ``total`` steps, after ``before`` others.
    """
    if progress is None:
        return None
    now = lambda done, of: before + steps * done // max(1, of)
    return lambda done, of, **figures: progress(now(done, of), total, **figures)


def listed(frames: Sequence[int]) -> str:
    """Return ascending frame numbers as text.

    Example:
        >>> listed([3, 7, 8, 9, 12])
        '3, 7-9, 12'
    """
    runs: list[list[int]] = []
    for k in frames:
        if runs and k == runs[-1][-1] + 1:
            runs[-1].append(k)
        else:
            runs.append([k])
    return ", ".join(f"{run[0]}-{run[-1]}" if len(run) > 1 else f"{run[0]}" for run in runs)


def with_reasons(frames: Mapping[int, str]) -> str:
    """Return frame numbers as text, with the reason of each.

    Example:
        >>> with_reasons({8: "its mask is empty", 3: "no picture", 7: "its mask is empty"})
        '3 (no picture), 7-8 (its mask is empty)'
    """
    those: dict[str, list[int]] = {}
    for k, why in sorted(frames.items()):
        those.setdefault(why, []).append(k)
    return ", ".join(f"{listed(some)} ({why})" for why, some in those.items())


def aligned(rows: Iterable[Sequence[str]], left: Collection[int] = (0,)) -> list[str]:
    """Return the lines of a table, with the columns ``left`` aligned left and others right.

    Example:
        >>> aligned([["part", "ms"], ["project", "3.1"]])
        ['part      ms', 'project  3.1']
    """
    rows = list(rows)
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    sides = ["<" if k in left else ">" for k in range(len(widths))]
    cells = lambda row: (f"{x:{s}{w}}" for x, s, w in zip(row, sides, widths, strict=True))
    return ["  ".join(cells(row)).rstrip() for row in rows]
