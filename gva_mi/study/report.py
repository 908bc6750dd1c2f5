"""The pages of a run (its pictures and figures), of a film's avatar, and of a study.

The first two are made from the run's folder (:mod:`gva_mi.fit.run_folder`) and the subject's. There
is no ground truth of a real film. So the page of its avatar begins with the avatar from all around
and in two motions that the film does not have, and says how to film it better
(:mod:`gva_mi.pose.film.film_check`). The moving pictures are also written as .mp4 files.

A subject counts once in a cell of a study's table: the figures of its cases are averaged first. The
refinement study has a row for each error model (of ``LIMITS`` for each case), their mean, and the
worst of each column. The avatar study has a row for each variant, separately for held-out and tuned
subjects, with the mean difference to the variant "full" of the same cases, because subjects differ
more than variants do.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import torch

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.pose import Pose
from gva_mi.body.smplx import BodyModel
from gva_mi.body.so3 import to_matrix
from gva_mi.core.console import Progress
from gva_mi.core.errors import expecting
from gva_mi.core.files import read_json
from gva_mi.core.options import from_json
from gva_mi.data.film import write_film
from gva_mi.data.pictures import read_image
from gva_mi.data.problems import Problem
from gva_mi.data.video import Video
from gva_mi.fit import run_folder
from gva_mi.fit.renders import WHITE, CameraPath, over, render_shots, shots
from gva_mi.pose.film.prepare_film import FilmRecord
from gva_mi.study.cases import FULL
from gva_mi.study.engine import Outcome
from gva_mi.study.evaluate import ALIGNED, REGIONS, SPLITS, Metrics
from gva_mi.study.figures import METRICS, Table, label_of, pivot, table, where
from gva_mi.study.page import Headline, Picture, Section, animation, picture, write_page
from gva_mi.study.pictures import dots, picture_sections, shown_views, turntable
from gva_mi.study.refinement import OVERLAYS, pose_tables
from gva_mi.synthetic.motion import perform

SHOWN = 4  # frames of a split
TURN_FRAMES = 24  # pictures of the turning avatar

FINDINGS = "film_check.json"  # on the film, in the subject's folder
TURNTABLE = "turntable"
DRIVEN = ("walk", "dance")  # motions of gva_mi.synthetic.motion
FPS = 20  # frames a second of the films
SECONDS = 6.0  # of a motion's round
SIZE = (384, 512)  # pixels
IN_PAGE = 3  # every 3rd picture of a film is in the page
SEED = 0  # of the motions

REFINE_SHOWN = (  # a study's tables
    "change", "stage 1 error, mm", "refined error, mm", "refined depth, mm", "increased",
    "IoU - limit", "mask IoU", "s a frame",
)  # fmt: skip
AVATAR_SHOWN = (  # metrics, and regions unless all are
    ("PSNR, dB", ("white",)), ("PSNR, dB", ("person", "hands", "face")), ("SSIM", ("white",)),
    ("LPIPS", ("white",)), ("rand_vgg", ("white",)), ("given error, mm", ()),
    ("trained error, mm", ()), ("spacing", ()), ("bias, mm", ()), ("stray, mm", ()),
    ("seconds", ()), ("Gaussians", ()),
)  # fmt: skip


def write_report(
    path: Path,
    run: Path,
    avatar: Avatar,
    video: Video,
    title: str,
    body: BodyModel,
    subtitle: str = "A 3D Gaussian avatar of body and hands from a monocular video.",
    first: Sequence[Section] = (),
    settings: Mapping[str, Any] = MappingProxyType({}),
) -> None:
    """Write the page.

    Args:
        path: of the page.
        run: the folder of a run that was evaluated.
        avatar: the fitted avatar.
        video: opened with the poses that the avatar was trained under.
        title, subtitle: head of the page.
        body: the fitted body model.
        first: sections that the page begins with; without them, the turning avatar.
        settings: what else the page lists at its end.
    """
    metrics = Metrics.load(run)
    views = shown_views(avatar, video, body)
    width, height = metrics.size
    write_page(
        path,
        title=title,
        subtitle=f"{subtitle} {width} x {height} pixels, seed {metrics.options['seed']}.",
        headlines=headlines(metrics),
        sections=[
            *(first or [_turning(avatar, video)]),
            *picture_sections(avatar, views, SHOWN),
            *_refinement(metrics, video.folder / OVERLAYS),
            *_reinitialisation(run, metrics),
            _scores(metrics),
        ],
        settings={
            **settings,
            "options": metrics.options,
            "protocol": metrics.protocol,
            "versions": metrics.versions,
        },
    )


def headlines(metrics: Metrics) -> list[Headline]:
    """Return pose errors first, because they limit all else; then PSNR, size and time."""
    figures, found = metrics.figures, []
    poses = {"region": "body", "alignment": "pelvis-aligned"}
    poses["metric"] = ("stage 1 error, mm", "refined error, mm")
    if errors := [f"{figure.value:.0f}" for figure in where(figures, **poses)]:
        label = "pelvis-aligned error of the body: stage 1, refined"
        found.append(Headline(f"{' → '.join(errors)} mm", label))
    for f in where(figures, metric="PSNR, dB", region=("white", "person"), split=SPLITS[1:]):
        if f.alignment in ("", ALIGNED):
            pixels = "whole picture" if f.region == "white" else "person's box"
            name = label_of((f.split, f.alignment, pixels))
            found.append(Headline(f"{f.value:.1f} dB", f"PSNR, {name}"))
    for f in where(figures, metric=("Gaussians", "steps", "seconds")):
        found.append(Headline(f"{f.value:,.0f}", f.metric))
    return found


def _turning(avatar: Avatar, video: Video) -> Section:
    caption = f"{len(avatar.canonical):,} Gaussians, {TURN_FRAMES} views"
    pictures = list(turntable(avatar, video.pose[len(video) // 2], TURN_FRAMES, video.size))
    return Section("The avatar", [animation(caption, pictures)], columns=3)


def _refinement(metrics: Metrics, overlays: Path) -> Iterator[Section]:
    """Show the refinement's picture and errors, if the subject's folder has the picture."""
    if overlays.exists():
        pictures = [picture("stage 1 above, refined below", read_image(overlays, 3))]
        tables = list(pose_tables(metrics.figures))
        yield Section("Pose refinement", pictures, columns=1, tables=tables)


def _reinitialisation(run: Path, metrics: Metrics) -> Iterator[Section]:
    """Show the Gaussians before and after each re-initialisation, and how they lie."""
    pictures = [
        dots(f"step {snapshot.step}, {name}", gaussians)
        for snapshot in run_folder.load_snapshots(run)
        for name, gaussians in (("before", snapshot.before), ("after", snapshot.after))
    ]
    shown = ("opaque Gaussians", "spacing", "bias, mm", "stray, mm")
    surface = pivot(where(metrics.figures, metric=shown), ("split",), ("region",))
    if pictures or surface:
        tables = [table(surface, "step")] if surface else []
        yield Section("Re-initialisation", pictures, columns=2, tables=tables)


def _scores(metrics: Metrics) -> Section:
    """List all scores, a table for each region."""
    tables = []
    for region in REGIONS:
        if own := where(metrics.figures, region=region, split=SPLITS):
            tables.append(table(pivot(own, ("split", "alignment", "region")), "renders"))
    return Section("Figures", tables=tables)


def write_film_report(
    out: Path,
    run: Path,
    video: Video,
    body: BodyModel,
    title: str,
    progress: Progress | None = None,
) -> None:
    """Write the page ``out/report.html``, and films of the avatar beside it.

    Args:
        out: folder.
        run: the folder of a run that was evaluated.
        video: opened with the poses that the avatar was trained under.
        body: the fitted body model.
        title: heading of the page.
        progress: called after each rendered picture.
    """
    avatar, record = run_folder.load_avatar(run), FilmRecord.load(video.folder)
    films = Section("The avatar moves", list(_films(out, avatar, video, progress)), columns=3)
    tall = "height was not given: sizes and distances are uncertain by 5 %."
    if record.height is not None:
        tall = f"height is given as {record.height:.2f} m."
    subtitle = f"{record.frames} frames at {record.fps:.3g} a second. The person's {tall}"
    first, settings = [films, _findings(video, record)], {"film": vars(record)}
    page = out / run_folder.REPORT
    write_report(page, run, avatar, video, title, body, subtitle, first, settings)


def _films(out: Path, avatar: Avatar, video: Video, progress: Progress | None) -> Iterator[Picture]:
    """Write the films of the avatar, and yield each as an animation."""
    motions = {TURNTABLE: (video.pose[_frame_from_front(video)], "turntable")}
    motions |= {name: (driven_motion(avatar, name), "static") for name in DRIVEN}
    for name, (motion, path) in motions.items():
        plan, images = shots(CameraPath(path=path, size=SIZE), avatar.rig, motion), []
        for layer in render_shots(avatar, motion, plan):
            images.append(over(layer, np.array(WHITE)))
            if progress:
                progress(len(images), len(plan))
        write_film(out / f"{name}.mp4", images, FPS, way="playable")
        yield animation(name, images[::IN_PAGE])


def driven_motion(avatar: Avatar, name: str) -> Pose:
    """Return one round of a motion of :data:`DRIVEN` for an avatar, as if the camera went along."""
    joints = avatar.rig.joints.double().numpy()
    expressions = avatar.rig.expression_joints.shape[2]
    t = np.arange(round(FPS * SECONDS)) / (FPS * SECONDS)
    pose = perform(name, t, joints, expressions, np.random.default_rng(SEED))
    pose = pose.map(lambda x: torch.as_tensor(x, dtype=torch.float32))
    return replace(pose, transl=pose.transl * torch.tensor([0.0, 1.0, 0.0]))


def _frame_from_front(video: Video) -> int:
    """Return the frame in which the person faces the camera most."""
    there = [k for k in range(len(video)) if k not in video.absent]
    ahead = to_matrix(video.pose.rotations[there, 0])[:, :, 2].double().numpy()
    axes = np.stack([video.cameras[k].T_camera_world[2, :3] for k in there])
    return there[int(np.argmin((ahead * axes).sum(1)))]


def _findings(video: Video, record: FilmRecord) -> Section:
    """List what went wrong with the film, and what to do about it."""
    path, expected = video.folder / FINDINGS, "the findings on a film"
    found, tables = read_json(path, expected), []
    with expecting(path, expected):
        problems = [from_json(Problem, one) for one in found["findings"]]
    if problems:
        rows = [(p.what, p.figure, p.cause, p.remedy) for p in problems]
        tables.append(Table(("what", "measured", "likely cause", "what to do"), rows, words=True))
    if record.notes:
        tables.append(Table(("notes",), [(note,) for note in record.notes], words=True))
    return Section("What to film better" if problems else "A good film", tables=tables)


def study_tables(kind: str, outcomes: Sequence[Outcome]) -> dict[str, list[Table]]:
    """Summarise a study, ``refine`` or ``avatar``: tables by their common title."""
    if kind == "refine":
        return {"error models": _refine_tables(outcomes)}
    return {
        f"{purpose} subjects": _avatar_tables([o for o in outcomes if o.case.purpose == purpose])
        for purpose in sorted({outcome.case.purpose for outcome in outcomes})
    }


def _refine_tables(outcomes: Iterable[Outcome]) -> list[Table]:
    """Return tables with a row for each error model, then their mean and the worst."""
    figures = [
        replace(figure, subject=outcome.case.take.name, variant=outcome.case.row)
        for outcome in outcomes
        for figure in outcome.figures
    ]
    tables = []
    for metric in REFINE_SHOWN:
        cells = pivot(where(figures, metric=metric), ("variant",), ("alignment", "region"))
        means, worst = {}, {}
        for column in dict.fromkeys(column for row in cells.values() for column in row):
            of_rows = [float(row[column].mean()) for row in cells.values() if column in row]
            means[column] = np.array(of_rows)
            worst[column] = np.array([METRICS[metric].worst(of_rows)])
        if cells:
            tables.append(table(cells | {("mean",): means, ("worst",): worst}, metric))
    return tables


def _avatar_tables(outcomes: Iterable[Outcome]) -> list[Table]:
    """Return tables with a row for each variant, and differences to "full" in the same cases."""
    figures, differences, tables = [], [], []
    for outcome in outcomes:
        figures += [figure for figure in outcome.figures if figure.split != "train"]
    key = lambda f: replace(f, variant=FULL.name, value=None)
    full = {key(f): f.value for f in figures if f.variant == FULL.name}
    for f in figures:
        if f.variant != FULL.name and None not in (f.value, full.get(key(f))):
            differences.append(replace(f, value=f.value - full[key(f)]))
    people = {outcome.case.name: outcome.case.take.name for outcome in outcomes}
    for metric, regions in AVATAR_SHOWN:
        about = {"metric": metric} | ({"region": regions} if regions else {})
        cells, against = (
            pivot(
                [replace(f, subject=people[f.subject]) for f in where(some, **about)],
                ("variant",),
                ("split", "alignment", "region"),
            )
            for some in (figures, differences)
        )
        write = lambda row, column, values, known=against: spread_text(
            values, column[-1], known.get(row, {}).get(column)
        )
        if cells:
            tables.append(table(cells, metric, write))
    return tables


def spread_text(values: np.ndarray, metric: str, against: np.ndarray | None) -> str:
    """Write mean and spread over subjects, the worst subject, and the difference to "full"."""
    form, worst = METRICS[metric].form, METRICS[metric].worst
    text = f"{values.mean():{form}} ± {values.std():{form}}"
    if len(values) > 1:
        text += f", worst {worst(values.tolist()):{form}}"
    return text if against is None else f"{text} ({against.mean():+{form}})"


def write_study_report(
    path: Path,
    kind: str,
    outcomes: Sequence[Outcome],
    settings: dict[str, Any],
) -> None:
    """Write the page of a study.

    Args:
        path: the ``.html`` file.
        kind: "refine" or "avatar".
        outcomes: all that were asked for.
        settings: options and versions.
    """
    shown = "change" if kind == "refine" else "PSNR, dB"
    sections = [
        Section(title.capitalize(), tables=tables)
        for title, tables in study_tables(kind, outcomes).items()
    ]
    own = [f for o in outcomes for f in o.figures if f.metric == shown and f.split != "train"]
    each = table(pivot(own, ("subject", "variant"), ("split", "alignment", "region")), "case")
    sections.append(Section("Each case", tables=[each], text=f"{shown} of each case."))
    purposes = ", ".join(sorted({outcome.case.purpose for outcome in outcomes}))
    subjects = len({outcome.case.take.name for outcome in outcomes})
    variants = ", ".join(dict.fromkeys(outcome.variant for outcome in outcomes))
    write_page(
        path,
        title=f"Study: {kind}",
        subtitle=f"Synthetic subjects: {subjects} ({purposes}). Variants: {variants}.",
        headlines=[],
        sections=sections,
        settings=settings,
    )
