"""The refinement study: stage 2 on subjects and errors that it was not tuned on.

One camera hardly determines a person's size, distance and focal length. The owner of a video may
know them: with :attr:`RefineStudyOptions.known`, height and focal length are the true ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress
from gva_mi.core.options import PythonOnly, options_of
from gva_mi.core.tasks import Task
from gva_mi.evaluate.figures import Figure
from gva_mi.evaluate.refinement import MeasuredRefinement, mask_iou
from gva_mi.evaluate.similarity import zoomed
from gva_mi.fit import paper
from gva_mi.refine import RefineOptions
from gva_mi.refine.refine import refine
from gva_mi.refine.sequence import SequenceOptions
from gva_mi.study.cases import StudyCase
from gva_mi.study.engine import Study
from gva_mi.study.videos import VideoOptions, Work, height_of, nudged, repeated
from gva_mi.subject.fingerprint import VIDEO_KIND
from gva_mi.subject.ground_truth import GroundTruth, load_ground_truth
from gva_mi.subject.video import Video, load_video

# Variants: poses as stage 1 leaves them, refined by Eq. 8 as printed, and by the default.
STAGE_1, PRINTED, REFINED = "stage 1", "Eq. 8 as printed", "refined"


@options_of("study")
class RefineStudyOptions(VideoOptions):
    """Size of the refinement study."""

    known: bool = False  # the subject's height and the focal length are given
    refine: PythonOnly[SequenceOptions] = field(default_factory=SequenceOptions)


@dataclass(frozen=True)
class RefineStudy(Study):
    """A study of the refinement, of Eq. 8 as printed, or of stage 1 unchanged."""

    options: RefineStudyOptions
    variants: Sequence[str] = (REFINED,)
    kind = "refine"

    def rounds(self, missing: Sequence[tuple[StudyCase, str]]) -> list[Sequence[Task]]:
        """Make the videos of the cases, then refine each case."""
        of, given = self.videos.subject, (self.body, self.options)
        measured = [
            Work(
                partial(
                    repeated,
                    [
                        partial(refinement_figures, of(case), case, variant, *given, run=run)
                        for run in range(self.options.repeats)
                    ],
                )
            )
            for case, variant in missing
        ]
        return [self.videos.work([case for case, _ in missing], self.body), measured]


def refinement_figures(
    subject: Path,
    case: StudyCase,
    variant: str,
    body: BodyModel,
    options: RefineStudyOptions,
    progress: Progress | None = None,
    run: int = 0,
) -> list[Figure]:
    """Measure a case of the refinement study; ``run`` changes one ulp (:func:`nudged`)."""
    if variant == STAGE_1:
        video = load_video(subject, normals="none")
        truth = load_ground_truth(video.truth, body)
        found = MeasuredRefinement(video, body, options.refine, None, truth)
    else:
        method = paper.REFINE if variant == PRINTED else options.refine
        found = refine_case(subject, case, body, method, options.known, progress, run)
    return [*found.figures(), Figure(metric="mask IoU", value=mask_iou(found.video))]


def refine_case(
    subject: Path,
    case: StudyCase,
    body: BodyModel,
    options: RefineOptions,
    known: bool = False,
    progress: Progress | None = None,
    run: int = 0,
) -> MeasuredRefinement:
    """Refine and measure a case's video; ``known``: with the true height and focal length."""
    video = nudged(load_video(subject, normals=None if case.normals else "none"), run)
    truth = load_ground_truth(video.truth, body)
    if isinstance(options, SequenceOptions):
        # the stage 1 of videos was given the height, too
        known_height = case.noise == VIDEO_KIND or known
        height = height_of(truth) if known_height else options.height
        options = replace(options, seed=case.draw, height=height)
    if not known:
        refined = refine(video, body, options, progress)
    else:
        focused = with_true_focal(truth, video, body)
        refined = replace(refine(focused, body, options, progress), cameras=focused.cameras)
    return MeasuredRefinement(video, body, options, refined, truth)


def with_true_focal(truth: GroundTruth, video: Video, body: BodyModel) -> Video:
    """Give a video the true focal length; its poses follow, as by ``prepare --lens``."""
    pelvis, zoom = body.rest(video.shape).joints[0], truth.cameras[0].fx / video.cameras[0].fx
    pose, cameras = zoomed(video.pose, pelvis, video.cameras, zoom)
    return replace(video, cameras=list(cameras), pose=pose)
