"""Problems found in a subject's folder, in words and figures: ``Problem`` and ``CheckReport``."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field
from typing import Literal

from gva_mi.core.console import listed

HEAD = ("", "what", "frames", "figure", "likely cause", "what to do")
_SHARES = (0, 2, 1, 2, 4, 4)  # of a table's width beyond the first column
_LONGEST = 40  # characters of a list of frames in the table; all of them are in the JSON


@dataclass(frozen=True)
class Problem:
    """One certain or possible fault of a subject's folder."""

    severity: Literal["error", "doubtful"]  # errors spoil the results; doubtful things may
    what: str  # the same few words for the same fault
    figure: str  # what was measured, with its unit
    cause: str
    remedy: str
    frames: tuple[int, ...] = ()  # empty if it is about no frame in particular


def error(what: str, figure: str, cause: str, remedy: str, frames: Iterable[int] = ()) -> Problem:
    """Return a problem that spoils the results."""
    return Problem("error", what, figure, cause, remedy, tuple(map(int, frames)))


def doubt(what: str, figure: str, cause: str, remedy: str, frames: Iterable[int] = ()) -> Problem:
    """Return a problem that may spoil the results."""
    return Problem("doubtful", what, figure, cause, remedy, tuple(map(int, frames)))


@dataclass
class CheckReport:
    """All problems of a folder, errors first."""

    frames: int  # of the video; 0 if none can be read
    problems: list[Problem]
    skipped: list[str] = field(default_factory=list)  # what was not checked, and why
    figures: dict[str, float] = field(default_factory=dict)  # of the folder as it is

    @property
    def errors(self) -> list[Problem]:
        """The problems that spoil the results."""
        return [p for p in self.problems if p.severity == "error"]

    def to_json(self) -> dict[str, object]:
        """Return the report as a dictionary for JSON."""
        return {
            "frames": self.frames, "findings": [asdict(p) for p in self.problems],
            "skipped": self.skipped, "figures": self.figures,
        }  # fmt: skip

    def lines(self, width: int) -> list[str]:
        """Return a table of ``width`` characters; nothing if there are no problems."""
        if not self.problems:
            return []
        first = max(len(p.severity) for p in self.problems)
        left = width - first - 2 * (len(HEAD) - 1)
        widths = [first, *(max(8, left * s // sum(_SHARES)) for s in _SHARES[1:])]
        lines = [*_row(HEAD, widths), "  ".join("-" * w for w in widths)]
        for p in self.problems:
            cells = (p.severity, p.what, self._short(p.frames), p.figure, p.cause, p.remedy)
            lines += _row(cells, widths)
        return lines

    def _short(self, frames: tuple[int, ...]) -> str:
        """Return frame numbers as the table shows them."""
        if frames and len(frames) == self.frames:
            return "all"
        text = listed(sorted(frames))
        many = f"{len(frames)} of {self.frames}, from {frames[0]} on" if frames else ""
        return text if len(text) <= _LONGEST else many


def _row(cells: Iterable[str], widths: list[int]) -> Iterator[str]:
    """Yield the lines of one row, its cells wrapped."""
    wrapped = [textwrap.wrap(c, w) or [""] for c, w in zip(cells, widths, strict=True)]
    for k in range(max(map(len, wrapped))):
        parts = (cell[k] if k < len(cell) else "" for cell in wrapped)
        yield "  ".join(x.ljust(w) for x, w in zip(parts, widths, strict=True)).rstrip()
