"""``Problem`` and ``CheckReport``: what is wrong with a subject's folder, or with a video."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Literal, TypeVar

from gva_mi.core.console import listed
from gva_mi.core.errors import InputError

T = TypeVar("T")


@dataclass(frozen=True)
class Problem:
    """One certain or possible fault."""

    severity: Literal["error", "doubtful"]  # errors spoil the results; doubtful things may
    what: str  # the same few words for the same fault
    figure: str  # what was measured, with its unit; or a reader's error
    cause: str
    remedy: str
    frames: Iterable[int] = ()  # empty: it concerns no frame in particular

    def __post_init__(self) -> None:
        object.__setattr__(self, "frames", tuple(map(int, self.frames)))

    def place(self, total: int) -> str:
        """Name the frames that it concerns, of ``total``; empty for none in particular."""
        if len(self.frames) == total > 0:
            return " in all frames"
        return f" in frames {listed(sorted(self.frames))}" if self.frames else ""


error, doubt = (partial(Problem, severity) for severity in ("error", "doubtful"))


@dataclass
class CheckReport:
    """All problems of a folder, errors first."""

    frames: int  # of the video; 0 if it cannot be opened
    problems: list[Problem]
    skipped: list[str] = field(default_factory=list)  # what was not checked, and why
    figures: dict[str, float] = field(default_factory=dict)

    @property
    def errors(self) -> list[Problem]:
        """The problems that spoil the results."""
        return [p for p in self.problems if p.severity == "error"]

    def to_json(self) -> dict[str, object]:
        """Return the report as a dictionary for JSON."""
        return {
            "frames": self.frames,
            "findings": [asdict(p) for p in self.problems],
            "skipped": self.skipped,
            "figures": self.figures,
        }

    def lines(self, width: int) -> Iterator[str]:
        """Yield the problems in lines of at most ``width`` characters."""
        for p in self.problems:
            what = f"{p.severity}: {p.what}{p.place(self.frames)}: {p.figure}"
            yield from textwrap.wrap(what, width)
            why = f"likely cause: {p.cause}; what to do: {p.remedy}"
            yield from textwrap.wrap(why, width, initial_indent="  ", subsequent_indent="  ")


class Faults:
    """Collects the errors of readers, which would stop any other step, as problems."""

    def __init__(self) -> None:
        self._found: list[tuple[str, int | None, str]] = []  # what is read, frame, error

    def attempt(
        self, what: str, frame: int | None, read: Callable[..., T], *given: object
    ) -> T | None:
        """Call ``read(*given)``; on an InputError keep it and return None.

        ``what`` says what is read; ``frame`` is its number, or None for the whole folder.
        """
        try:
            return read(*given)
        except InputError as refused:
            self._found.append((what, frame, str(refused)))
            return None

    def problems(self) -> Iterator[Problem]:
        """Yield a problem for each error; for many frames, one problem with the first error."""
        cause = "a file is missing, damaged, in an unexpected format, or of another video"
        remedy = "write it again in the format that docs/own_video.md describes"
        of_frames: dict[str, dict[int, str]] = {}
        for what, frame, reason in self._found:
            if frame is None:
                yield error(what, reason, cause, remedy)
            else:
                of_frames.setdefault(what, {})[frame] = reason
        for what, reasons in of_frames.items():
            frames = sorted(reasons)
            yield error(what, reasons[frames[0]], cause, remedy, frames)
