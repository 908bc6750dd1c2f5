"""``Finding`` and ``Report``: what is wrong with a subject's folder, in words and figures."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from typing import Literal

from gva_mi.core.console import listed

Severity = Literal["error", "doubtful"]
HEAD = ("", "what", "frames", "figure", "likely cause", "what to do")
_SHARES = (0, 2, 1, 2, 4, 4)  # of a table's width beyond the first column
_LONGEST = 40  # characters of a list of frames in the table; all of them are in the JSON


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong, or may be."""

    severity: Severity  # errors spoil what is computed; what is doubtful may
    what: str  # the same few words for the same fault
    figure: str  # what was measured, with its unit
    cause: str
    remedy: str
    frames: tuple[int, ...] = ()  # their numbers; none: it is about no frame more than another


@dataclass
class Report:
    """All that was found in a folder, errors first."""

    frames: int  # of the video; 0 where none can be read
    findings: list[Finding]
    skipped: list[str] = field(default_factory=list)  # what was not looked at, and why
    figures: dict[str, float] = field(default_factory=dict)  # of the folder as it is

    @property
    def errors(self) -> list[Finding]:
        """The findings that spoil what is computed."""
        return [f for f in self.findings if f.severity == "error"]

    def to_json(self) -> dict[str, object]:
        """All of it, for a file."""
        return asdict(self)

    def lines(self, width: int) -> list[str]:
        """The findings as a table of ``width`` characters; nothing where there are none."""
        if not self.findings:
            return []
        rows = [
            (f.severity, f.what, _short(f.frames, self.frames), f.figure, f.cause, f.remedy)
            for f in self.findings
        ]
        first = max(len(f.severity) for f in self.findings)
        left = width - first - 2 * (len(HEAD) - 1)
        widths = [first, *(max(8, left * s // sum(_SHARES)) for s in _SHARES[1:])]
        lines = list(_row(HEAD, widths))
        lines.append("  ".join("-" * w for w in widths))
        for row in rows:
            lines += _row(row, widths)
        return lines


def ordered(findings: Iterable[Finding]) -> list[Finding]:
    """Errors first, otherwise as they were found."""
    return sorted(findings, key=lambda f: f.severity != "error")


def _short(frames: tuple[int, ...], count: int) -> str:
    """Frame numbers as a table shows them."""
    if not frames:
        return ""
    if len(frames) == count:
        return "all"
    text = listed(sorted(frames))
    return text if len(text) <= _LONGEST else f"{len(frames)} of {count}, from {frames[0]} on"


def _row(cells: Iterable[str], widths: list[int]) -> Iterable[str]:
    """The lines of one row, its cells wrapped."""
    wrapped = [textwrap.wrap(c, w) or [""] for c, w in zip(cells, widths, strict=True)]
    for k in range(max(map(len, wrapped))):
        parts = [
            (cell[k] if k < len(cell) else "").ljust(w)
            for cell, w in zip(wrapped, widths, strict=True)
        ]
        yield "  ".join(parts).rstrip()
