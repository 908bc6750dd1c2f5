"""The folders of cases: a person is filmed once, and each noise is drawn over the recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gva_mi.body.smplx import BodyModel
from gva_mi.data.fingerprint import require_same_body
from gva_mi.data.synthetic import degrade, make_subject
from gva_mi.pose.evaluation.cases import Case


@dataclass(frozen=True)
class Filming:
    """How the videos of a study are made, and where they are."""

    folder: Path  # of the study
    frames: int  # of each video
    size: int  # pixels, width and height of the pictures
    novel: int = 0  # pictures of poses, and as many of views, that the video does not hold

    def subject(self, case: Case, noise: float = 1.0) -> Path:
        """The folder of a case's video, whether it is there or not."""
        return self.folder / "videos" / f"{self._person(case)}-{case.noise}-{case.draw}-{noise:g}"

    def film(self, case: Case, body: BodyModel, noise: float = 1.0) -> Path:
        """The same, made where it is missing.

        Args:
            case: whose video.
            body: the body that is fitted.
            noise: level of poses, masks and normals; 1 is usual.
        """
        take, subject = self.folder / "takes" / self._person(case), self.subject(case, noise)
        if not take.exists():
            make_subject(take, case.take.synth(self.frames, self.size, self.novel), body)
        if not subject.exists():
            degrade(take, subject, case.noise, case.draw, body, noise)
        require_same_body(subject, body)
        return subject

    def _person(self, case: Case) -> str:
        name = f"{case.take.name.replace(', ', '-').replace(' ', '')}-{self.frames}-{self.size}"
        return f"{name}-novel{self.novel}" if self.novel else name
