"""Problems found in a subject's folder, in words and figures: ``Problem`` and ``CheckReport``."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Literal

from gva_mi.core.console import listed

LONGEST = 44  # characters of a list of frames; all of them are in the JSON


@dataclass(frozen=True)
class Problem:
    """One certain or possible fault of a subject's folder."""

    severity: Literal["error", "doubtful"]  # errors spoil the results; doubtful things may
    what: str  # the same few words for the same fault
    figure: str  # what was measured, with its unit
    cause: str
    remedy: str
    frames: Iterable[int] = ()  # empty if it is about no frame in particular

    def __post_init__(self) -> None:
        object.__setattr__(self, "frames", tuple(map(int, self.frames)))


error, doubt = (partial(Problem, severity) for severity in ("error", "doubtful"))


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
        """Yield the problems in lines of at most ``width`` characters."""
        for p in self.problems:
            frames = f" in frames {listed(sorted(p.frames))}" if p.frames else ""
            if len(frames) > LONGEST:
                frames = f" in {len(p.frames)} frames from {p.frames[0]} on"
            if len(p.frames) == self.frames > 0:
                frames = " in all frames"
            yield from textwrap.wrap(f"{p.severity}: {p.what}{frames}: {p.figure}", width)
            why = f"likely cause: {p.cause}; what to do: {p.remedy}"
            yield from textwrap.wrap(why, width, initial_indent="  ", subsequent_indent="  ")
