"""The refinement study: accuracy of stage 2 on subjects and errors it was not tuned on.

One camera hardly determines a person's size, distance and focal length. The owner of a video may
know them: with :attr:`RefineStudyOptions.known`, height and focal length are the true ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress
from gva_mi.core.options import PictureSide, options_of
from gva_mi.core.tasks import Task
from gva_mi.data.fingerprint import FILM
from gva_mi.data.ground_truth import GroundTruth, load_ground_truth
from gva_mi.data.video import Video, load_video
from gva_mi.pose.refine import refine
from gva_mi.pose.sequence import SequenceOptions
from gva_mi.study.cases import StudyCase
from gva_mi.study.engine import Study, Work
from gva_mi.study.filmed import height_of
from gva_mi.study.measure import ERRORS, Evaluation, PoseFigures, mask_iou
from gva_mi.study.similarity import zoomed
from gva_mi.study.subjects import Filming, filming_work
from gva_mi.study.tables import MILLIMETRES
from gva_mi.synthetic.options import VideoFrames

STAGE_1, REFINED = "stage 1", "refined"  # variants


@options_of("study")
class RefineStudyOptions:
    """Size of the study."""

    frames: VideoFrames = 64  # frames of each video
    size: PictureSide = 512  # pixels, width and height of the pictures
    known: bool = False  # the subject's height and the focal length are given
    lens: bool = True  # of films, the focal length is given, as most phones record it
    refine: SequenceOptions = field(default_factory=SequenceOptions)


@dataclass(frozen=True)
class RefineStudy(Study):
    """A study of one variant: the refinement, or stage 1 as it is."""

    options: RefineStudyOptions
    variants: Sequence[str] = (REFINED,)
    kind = "refine"

    @property
    def _filming(self) -> Filming:
        options = self.options
        return Filming(self.folder, options.frames, options.size, lens=options.lens)

    def rounds(self, missing: Sequence[tuple[StudyCase, str]]) -> list[Sequence[Task]]:
        """Film the takes, then refine each case."""
        options, cases = self.options, [case for case, _ in missing]
        filming, frames = self._filming, options.frames
        measured = [
            Work(10 * frames, partial(figures, filming.subject(x), x, variant, self.body, options))
            for x, variant in missing
        ]
        return [filming_work(filming, cases, self.body), measured]


def figures(
    subject: Path,
    case: StudyCase,
    variant: str,
    body: BodyModel,
    options: RefineStudyOptions,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Measure a case; return the columns of the table, and the figures of ``refinement.json``."""
    if variant == STAGE_1:
        video = load_video(subject, normals="none")
        truth = load_ground_truth(video.truth, body)
        found = Evaluation(video, body, options.refine, None, truth)
    else:
        found = refine_case(subject, case, body, options.refine, options.known, progress)
    means = found.measured.means
    return columns(means) | {"masks: IoU": mask_iou(found.video)} | means.to_json()


def columns(figures: PoseFigures) -> dict[str, float | None]:
    """Return what the study's table shows of a refinement (:mod:`gva_mi.study.tables`)."""
    names = ("body", "hands", "feet", "body_aligned", "hands_aligned", "feet_aligned", "fingers")
    titles = (" ".join(reversed(name.split("_"))) for name in names)  # aligned body
    shown = {f"change: {t}": figures.relative(name) for t, name in zip(titles, names, strict=True)}
    for group, kind in zip(MILLIMETRES, ("", "_aligned"), strict=True):
        for part in ("body", "hands", "feet"):
            key = ERRORS[f"{part}{kind}"]
            shown |= {f"{group}: {part}, stage 1": figures[f"{key}_stage1"]}
            shown |= {f"{group}: {part}": figures[key]}
    iou, limit = figures["iou"], figures["iou_truth"]
    return shown | {
        "depth: ankles, mm": figures["ankle_depth_mm"],
        "depth: wrists, mm": figures["wrist_depth_mm"],
        "frames: increased": figures["frames_worse"],
        "frames: increased, hands": figures["frames_worse_hands"],
        "iou: IoU - limit": None if None in (iou, limit) else iou - limit,
        "time: s a frame": figures["seconds_per_frame"] or None,
    }


def refine_case(
    subject: Path,
    case: StudyCase,
    body: BodyModel,
    options: SequenceOptions,
    known: bool = False,
    progress: Progress | None = None,
) -> Evaluation:
    """Refine and measure a case's video; ``known``: with the true height and focal length."""
    video = load_video(subject, normals=None if case.normals else "none")
    truth, options = load_ground_truth(video.truth, body), replace(options, seed=case.draw)
    if case.noise == FILM:  # its stage 1 was given the height, too
        options = replace(options, height=height_of(truth))
    if not known:
        refined = refine(video, body, options, progress)
    else:
        zoomed = with_true_focal(truth, video, body)
        refined = refine(zoomed, body, replace(options, height=height_of(truth)), progress)
        refined = replace(refined, cameras=zoomed.cameras)
    return Evaluation(video, body, options, refined, truth)


def with_true_focal(truth: GroundTruth, video: Video, body: BodyModel) -> Video:
    """Give a video the true focal length; its poses follow, as by ``prepare --lens``."""
    pelvis, zoom = body.rest(video.shape).joints[0], truth.cameras[0].fx / video.cameras[0].fx
    pose, cameras = zoomed(video.pose, pelvis, video.cameras, zoom)
    return replace(video, cameras=list(cameras), pose=pose)
