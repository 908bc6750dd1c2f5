"""How well the refinement does on people it was not tuned on.

Its weights and rates were chosen on six subjects, :data:`TUNING`: two of the study's seven, two
drawn from seeds, and two without clothes. They are judged on :data:`HELD_OUT`: other people, other
clothes, other motion, other noise, which no choice had seen. Only the figures of the second set say
what to expect; the first is there so that the difference can be seen.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from pathlib import Path

from gva_mi.body.pose import load_poses
from gva_mi.body.smplx import BodyModel
from gva_mi.console import Progress
from gva_mi.data.fingerprint import require_same_body
from gva_mi.data.synthetic import SynthOptions, make_subject
from gva_mi.data.video import load_video
from gva_mi.pose.evaluation.measure import REGIONS, Measured, VertexErrors, measure
from gva_mi.pose.refine import refine
from gva_mi.pose.sequence import SequenceOptions


@dataclass(frozen=True)
class Case:
    """One person and the noise of one recording."""

    name: str
    subject: str | None = None  # of the study's seven; None: drawn from the seed
    seed: int = 0
    bare: bool = False  # without clothes and hair
    motion: str = "turn"

    def synth(self, noise: float, frames: int, size: int) -> SynthOptions:
        """How it is made; without novel poses and views, which the refinement does not look at."""
        return SynthOptions(
            seed=self.seed, subject=self.subject, motion=self.motion, frames=frames, size=size,
            clothes=not self.bare, hair=not self.bare, noise=noise, novel_poses=0, novel_views=0,
        )  # fmt: skip


TUNING = (
    Case("amira", "amira"),
    Case("dalia", "dalia"),
    Case("seed 0", seed=0),
    Case("seed 2", seed=2),
    Case("bare, seed 3", seed=3, bare=True),
    Case("bare, seed 14", seed=14, bare=True),
)
HELD_OUT = (
    Case("bruno", "bruno"),
    Case("edgar", "edgar"),
    Case("seed 11", seed=11),
    Case("seed 12", seed=12),
    Case("seed 13", seed=13),
    Case("everyday, seed 17", seed=17, motion="everyday"),
    Case("bare, seed 16", seed=16, bare=True),
)


@dataclass(frozen=True)
class StudyOptions:
    """How large the study is."""

    noise: tuple[float, ...] = (1.0,)  # levels of poses, masks and normals; 1 is usual
    frames: int = 64  # of each video
    size: int = 512  # pixels, width and height of the pictures
    refine: SequenceOptions = field(default_factory=SequenceOptions)


@dataclass(frozen=True)
class CaseResult:
    """What came of one case at one level of noise."""

    case: Case
    noise: float
    measured: Measured  # frame by frame

    @property
    def stage1_mm(self) -> dict[str, float]:
        """Mean error before, by region of the body."""
        return _means(self.measured.stage1)

    @property
    def refined_mm(self) -> dict[str, float]:
        """Mean error after, by region of the body."""
        return _means(self.measured.refined)

    @property
    def change(self) -> dict[str, float]:
        """By region of the body: -0.5 where the error was halved; NaN where there was none."""
        before, after = self.stage1_mm, self.refined_mm
        return {r: after[r] / before[r] - 1 if before[r] else math.nan for r in REGIONS}


def study(
    folder: Path,
    cases: Sequence[Case],
    body: BodyModel,
    options: StudyOptions,
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> Iterator[CaseResult]:
    """Refine the cases, one after the other.

    Args:
        folder: where subjects are; those that are missing are made.
        cases: such as HELD_OUT.
        body: the body that subjects are made on.
        options: how large.
        progress: called as ``progress(done, total)`` after each case.
        executor: who refines; None: this process.
    """
    work = [(case, noise) for noise in options.noise for case in cases]
    for done, (case, noise) in enumerate(work, start=1):
        synth = case.synth(noise, options.frames, options.size)
        name = case.name.replace(", ", "-").replace(" ", "")
        subject = folder / f"{name}-{case.motion}-{noise:g}-{options.frames}-{options.size}"
        if not subject.exists():
            make_subject(subject, synth, body)
        require_same_body(subject, body)
        video = load_video(subject)
        refined = refine(video, body, replace(options.refine, seed=case.seed), executor=executor)
        truth = load_poses(video.truth / "poses.npz")
        yield CaseResult(case, noise, measure(video, body, refined, truth))
        if progress is not None:
            progress(done, len(work))


def _means(errors: VertexErrors) -> dict[str, float]:
    return {region: float(getattr(errors, region).mean()) for region in REGIONS}
