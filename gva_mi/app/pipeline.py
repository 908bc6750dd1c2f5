"""Run all steps: on a video of one person, each resumable, or on a synthetic subject.

::

    out/
      subject/      the folder that the steps before a fit write
      run/          the fit and its metrics; of a synthetic subject also their report
      report.html   only for a video: the page about the avatar, with videos beside it
      avatar.html   only for a video: a page that plays the avatar
      avatar.json   only for a video: the stamp of each step (:mod:`gva_mi.core.stamp`)

For a video, the same call made again repeats only steps that are unfinished, or that depend on
something that changed.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

from gva_mi.app.steps import check, evaluate, fit, prepare, refine
from gva_mi.body.smplx import load_body
from gva_mi.core.atomic import folder_lock, holds_something, require_ours, require_writable
from gva_mi.core.console import bar, say
from gva_mi.core.errors import InputError, expecting
from gva_mi.core.files import make_room, read_json, write_json
from gva_mi.core.options import PictureSide, Seed, options_of
from gva_mi.core.stamp import results_version, stamp, start_folder
from gva_mi.core.tasks import usual_workers
from gva_mi.evaluate.report import FINDINGS, WEB_PAGE, write_avatar_report
from gva_mi.fit import run_folder
from gva_mi.fit.options import FitOptions, FromOne
from gva_mi.readers.own_masks import MaskOptions
from gva_mi.refine.sequence import SequenceOptions
from gva_mi.stage1.prepare import PrepareVideoOptions, Stage1Record
from gva_mi.subject.folder import (
    CAMERAS,
    FRAMES,
    LANDMARKS,
    MASKS,
    OVERLAY,
    POSES,
    PREPARED,
    REFINED_POSES,
    SPLITS,
    SubjectWriter,
)
from gva_mi.subject.footage import files_of
from gva_mi.subject.splits import Splits
from gva_mi.subject.video import load_video
from gva_mi.synthetic import SynthOptions, make_subject
from gva_mi.synthetic.options import VideoFrames

SUBJECT, RUN = "subject", "run"
VIDEO_MARKER, DEMO_MARKER = "avatar.json", "demo.json"  # marker files of such folders
DEMO_PERSON = "amira"  # one of the named synthetic subjects


class Quality(NamedTuple):
    """Work of the two long steps.

    Example:
        >>> QUALITIES["draft"].fit_steps
        500
    """

    passes: int  # of the refinement
    learn: int  # passes before its prior is inferred
    fit_steps: int
    evaluated: int | None = None  # test frames at most, and nothing else; None: all splits


QUALITIES = {  # chosen: a draft shows soon whether a video suits; "fine" spends more on pictures
    "draft": Quality(8, 4, 500, 8),
    "usual": Quality(SequenceOptions.passes, SequenceOptions.learn, 2000),
    "fine": Quality(SequenceOptions.passes, SequenceOptions.learn, 5000),
}


@options_of("avatar")
class AvatarEffort:
    """How much work is spent on an avatar.

    Example:
        >>> AvatarEffort("draft").fitting().steps, AvatarEffort(steps=100).fitting().steps
        (500, 100)
    """

    quality: Literal["draft", "usual", "fine"] = "usual"  # draft: a quick preview
    # Steps of the fit. Half as many come before them and improve the poses, except for a draft.
    # Without it, the quality decides.
    steps: FromOne | None = None
    # Leave every 8th frame, and a tenth of the video in one piece, out of training (at most 16
    # frames each), and measure the avatar there; no: train on all frames.
    test_frames: bool = True

    def refining(self, height: float | None) -> SequenceOptions:
        """Return the options of the refinement; ``height`` is the person's, metres, if known."""
        quality = QUALITIES[self.quality]
        return SequenceOptions(passes=quality.passes, learn=quality.learn, height=height)

    def fitting(self) -> FitOptions:
        """Return the options of the fit."""
        steps = self.steps or QUALITIES[self.quality].fit_steps
        options = FitOptions(steps=steps).of_video()
        return replace(options, first_steps=0) if self.quality == "draft" else options


def avatar(
    video: Path | str,
    out: Path | str,
    options: PrepareVideoOptions = PrepareVideoOptions(),  # noqa: B008 (frozen)
    effort: AvatarEffort = AvatarEffort(),  # noqa: B008 (frozen)
    own_masks: MaskOptions = MaskOptions(),  # noqa: B008 (frozen)
    *,
    person: int | None = None,
    lens: str | None = None,
    body: Path | None = None,
    overwrite: bool = False,
) -> None:
    """Make an avatar from a video: prepare, check, refine, fit, evaluate, report.

    If it was interrupted, the same call resumes it. With other options, the call repeats only the
    steps that depend on them.

    Args:
        video: a video file of one person who turns around once, or a folder of its pictures.
        out: the folder.
        options, own_masks, person, lens: as for :func:`gva_mi.app.prepare`.
        effort: how much work is spent.
        body: a body file; without it, the built-in body.
        overwrite: replace an existing avatar.

    Example:
        >>> avatar("no_such_video.mp4", "out")
        Traceback (most recent call last):
        gva_mi.core.errors.InputError: no_such_video.mp4: no such video file or folder of pictures
    """
    video, out = Path(video), Path(out)
    if not video.exists():
        raise InputError(f"{video}: no such video file or folder of pictures")
    model = load_body(body)  # a bad file is refused before any work
    subject, run = out / SUBJECT, out / RUN
    refining, fitting = effort.refining(options.height), effort.fitting()
    refined, findings = subject / REFINED_POSES, subject / FINDINGS
    few, draft = QUALITIES[effort.quality].evaluated, effort.quality == "draft"
    title = f"{'A draft avatar' if draft else 'An avatar'} of {video.name}"

    def prepare_anew(begun: bool) -> None:
        named = {"person": person, "lens": lens, "body": body}
        prepare(video, subject, options, own_masks, **named, overwrite=True)

    def check_anew(begun: bool) -> None:
        write_json(findings, check(subject, body=body).to_json())

    def refine_anew(begun: bool) -> None:
        refine(subject, refining, workers=usual_workers(), body=body, overwrite=True)

    def fit_or_resume(begun: bool) -> None:
        begun = begun and (run / run_folder.OPTIONS).exists()
        fit(subject, run, fitting, poses=refined, body=body, resume=begun, overwrite=not begun)

    def evaluate_anew(begun: bool) -> None:
        evaluate(run, subject, poses=refined, body=body, few=few, page=False)

    def report(begun: bool) -> None:
        trained = run_folder.under_trained_poses(load_video(subject, refined), run)
        with bar("report") as progress:
            write_avatar_report(out, run, trained, model, title, progress, draft)

    # Files that each step reads and writes: a step is run again if what it reads has changed.
    body_files = [] if body is None else [body]
    inputs = [video, *body_files, *filter(None, vars(own_masks).values())]
    parts = (FRAMES, MASKS, OVERLAY, CAMERAS, LANDMARKS, POSES, PREPARED)
    prepared = [*body_files, *(subject / name for name in parts)]
    before_fit = [*prepared, subject / SPLITS, refined]
    fitted = [run / run_folder.AVATAR, run / run_folder.TRAINED_POSES]
    metrics, page = run / run_folder.METRICS, out / run_folder.REPORT
    prepare_options = [asdict(options), asdict(own_masks), person, lens]
    steps = [
        Step("prepare", "video", prepare_options, inputs, [subject / PREPARED], prepare_anew),
        Step("check", "refine", None, prepared, [findings], check_anew),
        Step("refine", "refine", refining, prepared, [refined], refine_anew),
        Step("split", "refine", effort.test_frames, [subject / PREPARED], [subject / SPLITS],
             lambda begun: _split(subject, effort.test_frames)),
        Step("fit", "avatar", fitting.plain(), before_fit, fitted, fit_or_resume),
        Step("evaluate", "avatar", few, [*before_fit, *fitted], [metrics], evaluate_anew),
        Step("report", "avatar", draft, [*before_fit, findings, *fitted, metrics],
             [page, out / WEB_PAGE], report),
    ]  # fmt: skip
    source = stamp(files_of(video) or [video])
    with folder_lock(out, "gva-mi avatar"):
        StepFolder(out, VIDEO_MARKER, source, overwrite).follow(steps)
    say(f"avatar: {run / run_folder.AVATAR}")
    say(f"report: {page}")


@dataclass(frozen=True)
class Step:
    """One step of a command.

    Example:
        Another option, another stamp: the step has to run again.

        >>> step = Step("fit", "avatar", {"steps": 500}, reads=[], writes=[], run=print)
        >>> step.stamp() == replace(step, options={"steps": 2000}).stamp()
        False
    """

    name: str  # one word, for the printed lines
    results: str  # the key of RESULTS_VERSIONS whose version counts
    options: Any  # everything that it depends on, except files
    reads: Sequence[Path]  # files and folders of files
    writes: Sequence[Path]  # the step is finished only if these exist
    run: Callable[[bool], None]  # its argument: whether the same step was begun before

    def stamp(self) -> str:
        """Return the stamp of everything that the step depends on."""
        return stamp(self.reads, [self.name, self.options], results_version(self.results))


class StepFolder:
    """A folder whose steps are run once each.

    Its marker is ``{"source": ..., "steps": {name: {"stamp", "finished"}}}``.

    Example:
        The second time, the step is not run again.

        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as name:
        ...     made = Path(name) / "made.txt"
        ...     write = lambda begun: made.write_text("done")
        ...     step = Step("write", "avatar", None, [], [made], write)
        ...     StepFolder(Path(name), "steps.json", "source", overwrite=False).follow([step])
        ...     StepFolder(Path(name), "steps.json", "source", overwrite=False).follow([step])
        1/1 write: 0 s
        1/1 write: was finished before
    """

    def __init__(self, folder: Path, marker: str, source: str, overwrite: bool) -> None:
        """Start a folder, or continue one of the same ``source``, a stamp.

        Raises:
            InputError: the folder holds something else.
        """
        self._path, self._source = folder / marker, source
        self._steps: dict[str, dict[str, Any]] = {}
        if overwrite:
            make_room(folder, marker, overwrite)
        elif holds_something(folder, marker):
            require_ours(folder, marker)
            expected = "the finished steps of a command"
            found = read_json(self._path, expected)
            with expecting(self._path, expected):
                if found["source"] == source:
                    self._steps = {name: dict(step) for name, step in found["steps"].items()}
                elif any(step["finished"] for step in found["steps"].values()):
                    raise InputError(
                        f"{folder}: was made from another video; choose another folder, or give "
                        "--overwrite to replace it"
                    )
        require_writable(folder)
        self._write()

    def follow(self, steps: Iterable[Step]) -> None:
        """Run the steps that are not finished, in order."""
        steps = list(steps)
        for number, step in enumerate(steps, 1):
            number_of = f"{number}/{len(steps)}"
            made_of, known = step.stamp(), self._steps.get(step.name, {})
            same, finished = known.get("stamp") == made_of, known.get("finished", False)
            if same and finished and all(path.exists() for path in step.writes):
                say(f"{number_of} {step.name}: was finished before")
                continue
            self._steps[step.name] = {"stamp": made_of, "finished": False}
            self._write()
            begin = time.perf_counter()
            step.run(same and not finished)
            say(f"{number_of} {step.name}: {time.perf_counter() - begin:.0f} s")
            self._steps[step.name]["finished"] = True
            self._write()

    def _write(self) -> None:
        write_json(self._path, {"source": self._source, "steps": self._steps})


def _split(subject: Path, test_frames: bool) -> None:
    """Choose the test frames, which are left out of training."""
    count = Stage1Record.load(subject).frames
    every = Splits(list(range(count)), [])
    splits = Splits.of_video(count) if test_frames else every
    SubjectWriter(subject).splits(splits.to_json())


@dataclass(frozen=True)
class DemoOptions:
    """How large the demo is; the defaults take some 3 minutes on 2 cores.

    Example:
        >>> DemoOptions(frames=32).size
        400
    """

    seed: Seed = 0  # for the subject, the refinement and the fit
    frames: VideoFrames = 64  # number of frames of the video
    size: PictureSide = 400  # pixels, width and height
    steps: FromOne = 2000  # steps of the fit


def demo(
    out: Path | str,
    options: DemoOptions = DemoOptions(),  # noqa: B008 (frozen)
    *,
    overwrite: bool = False,
) -> None:
    """Run all steps on a synthetic subject: synth, refine, fit, evaluate.

    Args:
        out: folder for the subject and the run.
        options: size of the demo.
        overwrite: replace an existing demo.

    Example:
        >>> demo("out", DemoOptions(frames=32))  # doctest: +SKIP
    """
    out, start, workers = Path(out), time.perf_counter(), usual_workers()
    subject, run = out / SUBJECT, out / RUN
    # All options first: a bad one is refused before anything is written or replaced.
    made = SynthOptions(
        seed=options.seed, subject=DEMO_PERSON, frames=options.frames, size=options.size,
        workers=workers,
    )  # fmt: skip
    fitting = FitOptions(seed=options.seed, steps=options.steps)
    with folder_lock(out, "gva-mi demo"):
        start_folder(out, DEMO_MARKER, overwrite, {"options": asdict(options)})
        with bar("synth") as progress:
            make_subject(subject, made, load_body(), progress)
        refine(subject, SequenceOptions(seed=options.seed), workers=workers)
        fit(subject, run, fitting)
        evaluate(run, subject, title="The demo subject")
    minutes = (time.perf_counter() - start) / 60
    say(f"{minutes:.1f} minutes; report: {run / run_folder.REPORT}")
