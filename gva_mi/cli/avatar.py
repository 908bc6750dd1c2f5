"""The command ``gva-mi avatar``: a film of one person becomes an avatar, and a page about it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.smplx import load_body
from gva_mi.cli.arguments import MOST_PEOPLE, Flat, Switch
from gva_mi.cli.evaluate import evaluate_run
from gva_mi.cli.fit import fit_video
from gva_mi.cli.resume import Step, StepFolder
from gva_mi.core.atomic import atomic_dir, folder_lock
from gva_mi.core.console import bar, say
from gva_mi.core.errors import InputError
from gva_mi.core.files import make_room, write_json
from gva_mi.core.options import Seed, Within, options_of
from gva_mi.core.stamp import stamp
from gva_mi.core.tasks import usual_workers
from gva_mi.data.check import check_subject
from gva_mi.data.fingerprint import PREPARED
from gva_mi.data.folder import CAMERAS, LANDMARKS, POSES, REFINED_POSES, SPLITS
from gva_mi.data.importers.footage import files_of
from gva_mi.data.importers.prepare_options import MaskOptions
from gva_mi.data.landmarks import Landmarks
from gva_mi.data.problems import CheckReport
from gva_mi.data.splits import Splits
from gva_mi.data.video import Video, load_video
from gva_mi.fit import run_folder
from gva_mi.fit.options import FitOptions, FromOne
from gva_mi.pose.film.film_check import check_film
from gva_mi.pose.film.prepare_film import FilmOptions, FilmRecord, prepare_film
from gva_mi.pose.sequence import SequenceOptions
from gva_mi.study.film_report import FINDINGS, write_film_report
from gva_mi.study.refinement import describe, refine_videos

MARKER = "avatar.json"
SUBJECT, RUN = "subject", "run"  # folders in the command's folder

QUALITY = {  # passes of the refinement, passes before its prior is inferred, steps of the fit
    "draft": (8, 4, 500),
    "usual": (SequenceOptions.passes, SequenceOptions.learn, 2000),
    "fine": (SequenceOptions.passes, SequenceOptions.learn, 5000),
}


@options_of("avatar")
class AvatarEffort:
    """How much work an avatar is worth."""

    quality: Literal["draft", "usual", "fine"] = "usual"  # draft: to see whether a film will do
    # Steps of the fit, before which half as many find better poses, unless it is a draft; without
    # it, by the quality.
    steps: FromOne | None = None
    # Leave every 8th frame and a tenth of the film in one piece (of a long film fewer, at most 16
    # each) out of training, to measure the avatar there; no: all frames train it.
    test_frames: bool = True
    seed: Seed = 0  # of the refinement and the fit


def avatar(
    film: Positional[Path],
    film_options: Flat[FilmOptions] = FilmOptions(),  # noqa: B008 (frozen)
    choice: Flat[AvatarEffort] = AvatarEffort(),  # noqa: B008 (frozen)
    own_masks: Flat[MaskOptions] = MaskOptions(),  # noqa: B008 (frozen)
    *,
    out: Path,
    person: Annotated[int, Within(1, MOST_PEOPLE)] | None = None,
    lens: str | None = None,
    body: Path | None = None,
    overwrite: Switch = False,
) -> None:
    """Make an avatar of a film: prepare, check, refine, fit, evaluate, report.

    If it was interrupted, the same command goes on; with other options it repeats only the steps
    that depend on them. Each step is also a command of its own.

    Args:
        film: a film of one person who turns round once, or a folder of its pictures.
        film_options: of the film.
        choice: how much work the avatar is worth.
        own_masks: masks that come from another program.
        out: folder for the subject (out/subject), the run (out/run), films and the page
            (out/report.html).
        person: where there are several, the number from the left; without it, the largest.
        lens: focal length, as 26mm of 35 mm film or in pixels; without it, what the film records,
            else a fitted one.
        body: a body in SMPL-X's format; without it the built-in body.
        overwrite: replace an avatar that is there.
    """
    if not film.exists():
        raise InputError(f"{film}: no such film or folder of pictures")
    load_body(body)  # a bad file is refused before any work
    work = _Work(film, film_options, choice, own_masks, out, person, lens, body)
    with folder_lock(out, "gva-mi avatar"):
        source = stamp(files_of(film) or [film])
        StepFolder(out, MARKER, source, overwrite).follow(work.steps())
    say(f"avatar: {work.run / run_folder.AVATAR}")
    say(f"report: {out / run_folder.REPORT}")


@dataclass(frozen=True)
class _Work:
    """The steps from a film to its report."""

    film: Path
    options: FilmOptions
    choice: AvatarEffort
    own_masks: MaskOptions
    out: Path
    person: int | None
    lens: str | None
    body: Path | None

    @property
    def subject(self) -> Path:
        return self.out / SUBJECT

    @property
    def run(self) -> Path:
        return self.out / RUN

    def steps(self) -> Iterator[Step]:
        """Yield all steps in order."""
        subject, run = self.subject, self.run
        body = [self.body] if self.body else []
        names = ("frames", "masks", CAMERAS, LANDMARKS, POSES, PREPARED)
        prepared = [*body, *(subject / name for name in names)]
        refined, findings = subject / REFINED_POSES, subject / FINDINGS
        fitted = [run / run_folder.AVATAR, run / run_folder.TRAINED_POSES]
        measured = [run / run_folder.METRICS, run / run_folder.REPORT]
        film = [asdict(self.options), asdict(self.own_masks), self.person, self.lens]
        sources = [self.film, *body, *filter(None, vars(self.own_masks).values())]
        yield Step("prepare", "refine", film, sources, [subject / PREPARED], self.prepare)
        yield Step("check", "refine", None, prepared, [findings], self.check)
        yield Step("refine", "refine", self.refine_options, prepared, [refined], self.refine)
        wanted = self.choice.test_frames
        yield Step("split", "refine", wanted, [subject / PREPARED], [subject / SPLITS], self.split)
        known = [*prepared, subject / SPLITS, refined]
        yield Step("fit", "avatar", self.fit_options.plain(), known, fitted, self.fit)
        known = [*known, *fitted]
        yield Step("evaluate", "avatar", None, known, measured, self.evaluate)
        page = [self.out / run_folder.REPORT]
        yield Step("report", "avatar", None, [*known, findings, *measured], page, self.report)

    @property
    def refine_options(self) -> SequenceOptions:
        """The options of the refinement."""
        passes, learn, _ = QUALITY[self.choice.quality]
        height = self.options.height
        return SequenceOptions(seed=self.choice.seed, passes=passes, learn=learn, height=height)

    @property
    def fit_options(self) -> FitOptions:
        """The options of the fit."""
        steps = self.choice.steps or QUALITY[self.choice.quality][-1]
        options = FitOptions(seed=self.choice.seed, steps=steps).of_film()
        return replace(options, first_steps=0) if self.choice.quality == "draft" else options

    def prepare(self, again: bool) -> None:
        """Make the subject's folder."""
        with atomic_dir(self.subject, PREPARED) as folder, bar("prepare") as progress:
            notes = prepare_film(
                folder, self.film, self.options, self.body, person=self.person, lens=self.lens,
                own_masks=self.own_masks, progress=progress,
            )  # fmt: skip
        for note in notes:
            say(f"{self.film}: {note}")

    def check(self, again: bool) -> None:
        """Compare the folder with itself, and the film with a good one."""
        model, record = load_body(self.body), FilmRecord.load(self.subject)
        with bar("check") as progress:
            report = check_subject(self.subject, model, None, progress)
            landmarks = Landmarks.load(self.subject / LANDMARKS)
            found = check_film(
                load_video(self.subject), model, landmarks, record.fps, record.crowded, progress
            )
        whole = CheckReport(report.frames, [*found, *report.problems], [], report.figures)
        for line in whole.lines(110):
            say(line)
        write_json(self.subject / FINDINGS, whole.to_json())

    def refine(self, again: bool) -> None:
        """Refine the poses."""
        model, video = load_body(self.body), load_video(self.subject)
        with bar("refine") as progress:
            how = self.refine_options, progress, usual_workers()
            for evaluation in refine_videos([video], model, *how):
                for line in describe(evaluation):
                    say(line)

    def split(self, again: bool) -> None:
        """Choose the frames that are left out of training."""
        count = FilmRecord.load(self.subject).frames
        every = Splits(list(range(count)), [])
        splits = Splits.of_film(count) if self.choice.test_frames else every
        write_json(self.subject / SPLITS, splits.to_json())

    def fit(self, again: bool) -> None:
        """Fit the avatar; go on from its last checkpoint if this very fit was begun before."""
        again = again and (self.run / run_folder.OPTIONS).exists()
        if not again:
            make_room(self.run, run_folder.OPTIONS, overwrite=True)
        video, poses = self.refined()
        sources = run_folder.sources_of(poses, self.body, self.subject)
        fit_video(video, load_body(self.body), self.fit_options, self.run, again, sources)

    def evaluate(self, again: bool) -> None:
        """Measure the avatar, also under poses that are fitted to the test frames."""
        video, poses = self.refined()
        found = Avatar.load(self.run / run_folder.AVATAR)
        about = {"name": "full", "title": self.title, "fit_poses": bool(video.splits.test)}
        evaluate_run(self.run, found, video, load_body(self.body), poses, **about)

    def report(self, again: bool) -> None:
        """Write films of the avatar, and the page."""
        video, _ = self.refined()
        trained = run_folder.under_trained_poses(video, self.run)
        with bar("report") as progress:
            model, title = load_body(self.body), self.title
            write_film_report(self.out, self.run, trained, model, title, progress)

    def refined(self) -> tuple[Video, Path]:
        """Open the video under its refined poses; return also their file."""
        poses = self.subject / REFINED_POSES
        video = load_video(self.subject, poses)
        video.require_train_frames()
        return video, poses

    @property
    def title(self) -> str:
        """Heading of the pages."""
        return f"An avatar of {self.film.name}"
