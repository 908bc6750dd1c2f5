"""The videos of a study: a subject is rendered once, and each error model degrades a copy.

The error model "film" is the real one: networks and solver see the pictures.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress
from gva_mi.core.stamp import RESULTS_VERSIONS
from gva_mi.data.fingerprint import FILM, require_same_body
from gva_mi.study.cases import StudyCase, Take
from gva_mi.study.engine import Work
from gva_mi.study.filmed import watch_take
from gva_mi.synthetic import degrade, make_subject


@dataclass(frozen=True)
class Filming:
    """Options of the videos of a study, and their folder."""

    folder: Path  # of the study
    frames: int  # of each video
    size: int  # pixels, width and height of the pictures
    novel: int = 0  # pictures of novel poses, and as many of novel views
    lens: bool = True  # whether the focal length of films is known

    def subject(self, case: StudyCase) -> Path:
        """Return the folder of a case's video, existing or not.

        A film's masks and poses are results of this program, so its folder names their version.
        """
        film = f"{FILM}{RESULTS_VERSIONS['refine']}{'' if self.lens else '-anylens'}"
        made = film if case.noise == FILM else case.noise
        return self.folder / "videos" / f"{self._name(case.take)}-{made}-{case.draw}"

    def film(
        self, cases: Sequence[StudyCase], body: BodyModel, progress: Progress | None = None
    ) -> None:
        """Make the videos of some cases that are missing."""
        for case in cases:
            take, subject = self.folder / "takes" / self._name(case.take), self.subject(case)
            if not take.exists():
                make_subject(take, case.take.synth(self.frames, self.size, self.novel), body)
            if not subject.exists() and case.noise == FILM:
                watch_take(take, subject, body, self.lens)
            elif not subject.exists():
                degrade(take, subject, case.noise, case.draw, body)
            require_same_body(subject, body)

    def _name(self, take: Take) -> str:
        frames, size = take.frames or self.frames, take.size or self.size
        name = f"{take.name.replace(', ', '-').replace(' ', '')}-{frames}-{size}"
        return f"{name}-novel{self.novel}" if self.novel else name


def filming_work(filming: Filming, cases: Iterable[StudyCase], body: BodyModel) -> list[Work]:
    """Return the work of filming cases, a piece for each take: no two workers render the same."""
    by_take: dict[Take, dict[StudyCase, None]] = {}
    for case in cases:
        by_take.setdefault(case.take, {})[case] = None
    return [
        Work(filming.frames * len(several), partial(filming.film, tuple(several), body))
        for several in by_take.values()
    ]
