"""Problems found in a subject's folder, in words and figures: ``Problem`` and ``CheckReport``."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field
from typing import Literal

from gva_mi.core.console import listed

LONGEST = 40  # characters of a list of frames


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

    def lines(self, width: int) -> Iterator[str]:
        """Yield the problems for people, in lines of at most ``width`` characters."""
        for p in self.problems:
            frames = f" in {self._listed(p.frames)}" if p.frames else ""
            yield from textwrap.wrap(f"{p.severity}: {p.what}{frames}: {p.figure}", width)
            why = f"likely cause: {p.cause}; what to do: {p.remedy}"
            yield from textwrap.wrap(why, width, initial_indent="  ", subsequent_indent="  ")

    def _listed(self, frames: tuple[int, ...]) -> str:
        """Return frame numbers in a few words; all of them are in the JSON."""
        if len(frames) == self.frames:
            return "all frames"
        text = f"frames {listed(sorted(frames))}"
        return text if len(text) <= LONGEST else f"{len(frames)} frames from {frames[0]} on"
