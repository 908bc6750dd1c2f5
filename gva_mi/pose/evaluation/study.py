"""How well the refinement does on people, noise and cameras that it was not tuned on.

A case (:mod:`gva_mi.pose.evaluation.cases`) is a take of one person under one noise. A take is
rendered once; its noises are drawn over it. Only the figures of held-out cases say what to expect;
those of the tuning cases are there so that the difference can be seen.

How large somebody is, how far away, and with which lens they were filmed, one camera hardly tells.
Their owner knows: of a video that was :attr:`StudyOptions.told`, height and lens are the true ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from pathlib import Path

from gva_mi.body.smplx import BodyModel
from gva_mi.console import Progress
from gva_mi.data.synthetic.options import Level, VideoFrames
from gva_mi.data.truth import Truth, load_truth
from gva_mi.data.video import Video, load_video
from gva_mi.pose.evaluation.cases import Case
from gva_mi.pose.evaluation.figures import PoseFigures
from gva_mi.pose.evaluation.measure import measure
from gva_mi.pose.evaluation.subjects import Filming
from gva_mi.pose.focal import follow
from gva_mi.pose.refine import refine
from gva_mi.pose.sequence import SequenceOptions
from gva_mi.ranges import PictureSide, require_ranges


@dataclass(frozen=True)
class StudyOptions:
    """How large the study is."""

    noise: tuple[Level, ...] = (1.0,)  # levels of poses, masks and normals; 1 is usual
    frames: VideoFrames = 64  # of each video
    size: PictureSide = 512  # pixels, width and height of the pictures
    told: bool = False  # the person's height and the lens, by somebody who knows them
    refine: SequenceOptions = field(default_factory=SequenceOptions)

    def __post_init__(self) -> None:
        require_ranges("study", self)


@dataclass(frozen=True)
class CaseResult:
    """What came of one case at one level of noise."""

    case: Case
    noise: float
    figures: PoseFigures


def study(
    folder: Path,
    cases: Sequence[Case],
    body: BodyModel,
    options: StudyOptions,
    known: Sequence[CaseResult] = (),
    progress: Progress | None = None,
    executor: Executor | None = None,
) -> Iterator[CaseResult]:
    """Refine the cases, one after the other.

    Args:
        folder: where subjects are; those that are missing are made.
        cases: such as HELD_OUT.
        body: the body that is fitted.
        options: how large.
        known: results of cases that need not be computed again.
        progress: called as ``progress(done, total)`` after each case.
        executor: who refines; None: this process.
    """
    done = {(result.case, result.noise): result for result in known}
    work = [(case, noise) for noise in options.noise for case in cases]
    for number, (case, noise) in enumerate(work, start=1):
        yield done.get((case, noise)) or _refined(folder, case, noise, body, options, executor)
        if progress is not None:
            progress(number, len(work))


def _refined(
    folder: Path,
    case: Case,
    noise: float,
    body: BodyModel,
    options: StudyOptions,
    executor: Executor | None,
) -> CaseResult:
    """Make the video of a case where it is missing, refine it, and measure what was found."""
    subject = Filming(folder, options.frames, options.size).film(case, body, noise)
    video = load_video(subject, normals=None if case.normals else "none")
    truth, chosen = load_truth(video.truth, body), replace(options.refine, seed=case.draw)
    if not options.told:
        refined = refine(video, body, chosen, executor=executor)
    else:
        told = through_lens_of(truth, video, body)
        refined = refine(told, body, replace(chosen, height=height_of(truth)), executor=executor)
        refined = replace(refined, cameras=refined.cameras or told.cameras)
    measured = measure(video, body, refined, truth)
    return CaseResult(case, noise, measured.means)


def through_lens_of(truth: Truth, video: Video, body: BodyModel) -> Video:
    """A video whose cameras have the true focal length; poses follow, as by ``prepare --lens``.

    Args:
        truth: of the video, with cameras of one lens.
        video: as stage 1 sees it.
        body: of its poses.
    """
    longer = truth.cameras[0].fx / video.cameras[0].fx
    pelvis = body.rest(video.shape).joints[0]
    cameras = [camera.zoomed(longer) for camera in video.cameras]
    return replace(video, cameras=cameras, pose=follow(video.pose, pelvis, video.cameras, longer))


def height_of(truth: Truth) -> float:
    """How tall the person is at rest, from the top of the head to the soles, metres."""
    y = truth.body.rest(truth.shape).vertices[:, 1]
    return float(y.max() - y.min())
