"""The command ``gva-mi study``: measure a step on held-out subjects, synthetic or real."""

from __future__ import annotations

import os
import shlex
import shutil
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from tyro.conf import Positional, arg, subcommand

from gva_mi.body.smplx import load_body
from gva_mi.cli.parse import Flat, Switch, parse
from gva_mi.core.atomic import folder_lock, require_writable
from gva_mi.core.console import aligned, bar, say
from gva_mi.core.cpu import SETTINGS
from gva_mi.core.errors import InputError, expecting
from gva_mi.core.files import read_json, require_room, write_json
from gva_mi.core.options import PythonOnly, Within, Workers, from_json, options_of
from gva_mi.core.stamp import versions
from gva_mi.core.tasks import cluster, local_executor
from gva_mi.evaluate.figures import Table, figures_from, pivot, table, to_json
from gva_mi.prior.body_height import PERSON_HEIGHTS
from gva_mi.readers.up_axis import Axis, axis_of
from gva_mi.stage1.prepare import PrepareVideoOptions
from gva_mi.study.avatar_study import AvatarStudy, AvatarStudyOptions
from gva_mi.study.cases import LIMITS, TUNING, StudyCase, held_out
from gva_mi.study.engine import EXPECTED, Outcome, Study, run_study
from gva_mi.study.multiview import multiview
from gva_mi.study.refine_study import (
    PRINTED,
    REFINED,
    STAGE_1,
    RefineStudy,
    RefineStudyOptions,
)
from gva_mi.study.relight import RelightStudy, RelightStudyOptions, lights_named
from gva_mi.study.report import study_tables, write_study_report
from gva_mi.study.variants import variants_named


@options_of("study")
class _Choice:
    """Options of both studies."""

    out: Path  # folder for results and subjects; missing subjects are generated
    # held-out: no option was tuned on them; limits: one video, with one thing changed at a time.
    cases: Literal["held-out", "tuning", "all", "limits"] = "held-out"
    # Number of the held-out set; once you tune on its results, take the next.
    held_out_set: Annotated[int, Within(1, 1000)] = 1
    # Error models, such as white, video or "no normals"; without it, all.
    error_models: tuple[str, ...] = ()
    subjects: tuple[str, ...] = ()  # names of the synthetic subjects, or seeds; without it, all
    workers: Workers = 1  # processes on this machine; any number gives the same bits
    # Address of a dask.distributed scheduler, whose workers compute the cases instead; all machines
    # must see the study's folder under the same path.
    scheduler: str | None = None
    body: PythonOnly[Path | None] = None  # in SMPL-X's .npz format; None: the built-in body
    overwrite: Switch = False  # recompute results that the file already holds


@dataclass(frozen=True)
class RefineChoice(_Choice):
    """Refine several synthetic subjects, and compare the poses with the ground truth.

    Writes refine.json and refine.html: by how much errors changed, for each error model, and the
    depth errors of ankles and wrists, positive if too far away. A stopped study is resumed.
    """

    # 1: only measure the poses before refinement, which takes little time.
    stage: Literal[1, 2] = 2
    printed: Switch = False  # also refine by Eq. 8 as printed, and compare the methods
    options: Flat[RefineStudyOptions] = field(default_factory=RefineStudyOptions)


@dataclass(frozen=True)
class AvatarChoice(_Choice):
    """Fit avatars of several synthetic subjects, with the full method and with each part left out.

    Writes avatar.json and avatar.html: PSNR, SSIM and perceptual metrics on test frames, novel
    poses and novel views, pose errors, distances of Gaussians to the surface, time; mean, spread
    and worst over subjects. A stopped study is resumed.
    """

    rows: tuple[str, ...] = ()  # variants, such as full or "with residual"; without it, all
    options: Flat[AvatarStudyOptions] = field(default_factory=AvatarStudyOptions)


@dataclass(frozen=True)
class RelightChoice(_Choice):
    """Fit draft avatars of synthetic subjects, and draw them in light that their videos lack.

    Writes relight.json and relight.html: PSNR of test frames against the same subjects in the same
    light, not relit, with the own light turned, and relit by a Mitsuba scene's light. Only cases on
    white take part.
    """

    lights: tuple[str, ...] = ()  # such as usual, left or sky; without it, all of synth --light
    options: Flat[RelightStudyOptions] = field(default_factory=RelightStudyOptions)


# The studies of the documents, by the names of their folders: `gva-mi study all` runs them.
STUDIES = {
    "eq8": "refine --held-out-set 31 --subjects 3100 3102 3103 3104 3108 "
    "--error-models bursts white slow lean --frames 16 --size 192 --printed",
    "alphas": "avatar --held-out-set 31 --error-models white --subjects 3102 --frames 16 "
    '--size 128 --steps 400 --novel 2 --no-fitted --rows "as printed" alphas',
    "limits": "refine --cases limits --stage 1",
    "simulated": "refine --held-out-set 72 --error-models bursts white slow mixed lean shape "
    'outliers focal masks normals anything "no normals" --frames 40 --size 320',
    "known": "refine --held-out-set 72 --error-models shape focal anything "
    "--frames 40 --size 320 --known",
    "variants": "avatar --held-out-set 72 --subjects 7200 7202 --error-models bursts white "
    "--frames 40 --size 256 --steps 1500 --no-fitted --rows full "
    '"without refinement" "without either" "without hand skeleton" "without re-initialisation"',
    "ladder": "avatar --held-out-set 72 --subjects 7200 7202 7204 --error-models bursts white slow "
    "--frames 40 --size 256 --steps 2000 --no-fitted --rows ladder full",
    "videos": "avatar --held-out-set 80 --error-models video --frames 48 --steps 2000 --no-fitted "
    "--rows full",
    "relit": "relight --held-out-set 75 --error-models white bursts --steps 1600 "
    "--lights left right above turned usual",
}
TABLE = "table.json"  # in the folder of `study all`: the figures of all its studies, one long table


@options_of("study all")
class AllChoice:
    """Run all studies of the documents, and write their figures to one long table.

    This takes days. Run it again to resume, or name some of the studies. The rows of table.json are
    those of each study, with the study's name and the error model ("row"). `python docs/tables.py`
    writes the tables of the documents from it.
    """

    out: Path  # folder; each study has a folder in it
    only: tuple[str, ...] = ()  # names of studies; without it, all
    workers: Workers = 1  # processes on this machine; any number gives the same bits


@options_of("study multiview")
class MultiviewChoice:
    """Compare stage 1 of real videos with points triangulated from several calibrated cameras.

    Each video is solved alone, as `gva-mi prepare video` does. Landmarks of all videos together
    give the points, which are accurate to a few centimetres. Prints lengths in millimetres.
    """

    videos: Positional[Path]  # folder of the videos, named after their cameras
    calibration: Positional[Path]  # of the cameras, as Pose2Sim, anipose and FreeMoCap write it
    up: Axis = "z"  # axis of the calibration's world
    known_lens: Switch = False  # solve the videos with their true focal lengths
    # The person's height, metres; without it, the height of an average person.
    height: Annotated[float, PERSON_HEIGHTS] | None = None
    json_file: Annotated[Path | None, arg(name="json")] = None  # where to write all figures


def study(
    what: Annotated[
        Annotated[RefineChoice, subcommand("refine", prefix_name=False)]
        | Annotated[AvatarChoice, subcommand("avatar", prefix_name=False)]
        | Annotated[RelightChoice, subcommand("relight", prefix_name=False)]
        | Annotated[MultiviewChoice, subcommand("multiview", prefix_name=False)]
        | Annotated[AllChoice, subcommand("all", prefix_name=False)],
        arg(name=""),
    ],
) -> None:
    """Measure the results of a step on subjects that it was not tuned on.

    Args:
        what: the step; its figures are written to files of its name.
    """
    if isinstance(what, MultiviewChoice):
        return _multiview(what)
    if isinstance(what, AllChoice):
        return _all(what)
    body, cases = load_body(what.body), _chosen(what)
    if isinstance(what, RefineChoice):
        variants = (STAGE_1,) if what.stage == 1 else (REFINED,)
        variants = (*variants, PRINTED) if what.printed else variants
        made = RefineStudy(what.out, body, what.options, variants)
    elif isinstance(what, RelightChoice):
        made = RelightStudy(what.out, body, what.options, lights_named(what.lights))
    else:
        made = AvatarStudy(what.out, body, what.options, variants_named(what.rows))
    with folder_lock(what.out, "gva-mi study"):
        require_writable(what.out)
        _run(what, made, cases)


def _all(what: AllChoice) -> None:
    """Run the studies one after the other; write the table anew after each."""
    for name in what.only:
        if name not in STUDIES:
            raise InputError(f"study all: --only has no '{name}'; there are: {', '.join(STUDIES)}")
    for name in what.only or STUDIES:
        words = [*shlex.split(STUDIES[name]), "--out", str(what.out / name)]
        say(f"gva-mi study {shlex.join(words)}")
        parse(study, "study", [*words, "--workers", str(what.workers)])()
        rows = [row for name in STUDIES for row in _figures(name, what.out / name)]
        write_json(what.out / TABLE, {"figures": rows})
    say(f"figures: {what.out / TABLE}")


def _figures(name: str, folder: Path) -> Iterator[dict[str, Any]]:
    """Yield the figures of a study with its name and the row of their case, if it has been run."""
    path = folder / f"{STUDIES[name].split()[0]}.json"
    if not path.exists():
        return
    with expecting(path, EXPECTED):
        record = read_json(path, EXPECTED)
        cases = {case: from_json(StudyCase, found) for case, found in record["cases"].items()}
        for figure in figures_from(record["figures"]):
            case = cases[figure.subject]
            yield {"study": name, "row": case.row} | asdict(figure) | {"subject": case.take.name}


def _run(what: _Choice, made: Study, cases: Sequence[StudyCase]) -> None:
    """Resume the study, save after each outcome, then print and write the tables."""
    known, others = _kept(what, made, cases)
    if what.overwrite and isinstance(made, AvatarStudy):
        for case in cases:
            for variant in made.variants:
                for number in range(made.options.repeats):
                    shutil.rmtree(made.run(case, variant, number).out, ignore_errors=True)
    if known:
        say(f"{len(known)} results are in {made.path}; --overwrite computes them again")
    outcomes: list[Outcome] = []
    with bar("study") as progress, _executor(what) as executor:
        for outcome in run_study(made, cases, known, progress, executor):
            outcomes.append(outcome)
            done = {outcome.key for outcome in outcomes}
            waiting = [outcome for outcome in known if outcome.key not in done]
            made.save([*outcomes, *waiting, *others])
    for title, tables in study_tables(made.kind, outcomes).items():
        say(title)
        for found in tables[:1] if made.kind == "avatar" else tables:
            _print(found)
    page, settings = made.path.with_suffix(".html"), {**made.made_with, "versions": versions()}
    write_study_report(page, made.kind, outcomes, settings)
    say(f"figures: {made.path}; page: {page}")


@contextmanager
def _executor(what: _Choice) -> Iterator[Executor | None]:
    """Yield what runs the cases."""
    if what.scheduler is None:
        with local_executor(what.workers) as pool:
            yield pool
    else:
        with cluster(what.scheduler, 0, _versions_and_settings) as client:
            yield client.get_executor(pure=False)


def _versions_and_settings() -> dict[str, str | None]:
    """Return what the bits of a result depend on; `gva-mi` makes the settings when it begins."""
    return versions() | {name: os.environ.get(name) for name in SETTINGS}


def _print(found: Table) -> None:
    for line in aligned([found.head, *found.rows]):
        say(line)


def _multiview(what: MultiviewChoice) -> None:
    """Solve the videos, then print and write a row for each camera."""
    if what.json_file is not None:
        require_room(what.json_file, overwrite=True)
    options = PrepareVideoOptions(height=what.height)
    with bar("study") as progress:
        figures = multiview(
            what.videos, what.calibration, load_body(), options, axis_of(what.up),
            what.known_lens, progress,
        )  # fmt: skip
    _print(table(pivot(figures, ("subject",), ("region",)), "camera"))
    if what.json_file is not None:
        write_json(what.json_file, {"figures": to_json(figures)})
        say(f"figures: {what.json_file}")


def _kept(
    what: _Choice, made: Study, cases: Sequence[StudyCase]
) -> tuple[list[Outcome], list[Outcome]]:
    """Split the results in the file: results of the selected cases, and all others."""
    try:
        kept = made.load()
    except InputError:
        if not what.overwrite:
            raise
        kept = []
    selected = [o for o in kept if o.case in cases and o.variant in made.variants]
    return ([] if what.overwrite else selected), [o for o in kept if o not in selected]


def _chosen(what: _Choice) -> list[StudyCase]:
    """Return the selected cases, without those that lack a package."""
    judging = held_out(what.held_out_set)
    both = (*TUNING, *judging)
    cases = {"held-out": judging, "tuning": TUNING, "all": both, "limits": LIMITS}[what.cases]
    chosen = list(cases)
    for name, asked, of in (
        ("error-models", what.error_models, lambda case: case.kind_of_errors),
        ("subjects", what.subjects, lambda case: case.take.person),
    ):
        there = dict.fromkeys(map(of, cases))
        for one in asked:
            if one not in there:
                known = ", ".join(there)
                raise InputError(f"study: --{name} has no '{one}'; these cases have: {known}")
        chosen = [case for case in chosen if not asked or of(case) in asked]
    if isinstance(what, RelightChoice):
        chosen = [case for case in chosen if case.take.scene == "white"]
    for case in filter(lambda case: case.lacks, chosen):
        say(f"{case.name}: left out, because the package {case.lacks} is not installed")
    chosen = [case for case in chosen if not case.lacks]
    if not chosen:
        on_white = ", on white" if isinstance(what, RelightChoice) else ""
        raise InputError(
            f"study: no case has both one of these error models and these subjects{on_white}"
        )
    return chosen
