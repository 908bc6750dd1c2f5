"""The report of a run: pictures of the avatar, its metrics, and its training.

It is made from the run's folder (:mod:`gva_mi.fit.run_folder`) and the subject's. The page of a
film's avatar (:mod:`gva_mi.study.film_report`) begins with films of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.smplx import BodyModel
from gva_mi.data.pictures import read_image, write_image
from gva_mi.data.video import Video
from gva_mi.fit import run_folder
from gva_mi.fit.photometric import FITTED
from gva_mi.fit.run_folder import Snapshot
from gva_mi.study import page
from gva_mi.study.evaluate import REGIONS
from gva_mi.study.metrics import ALIGNED, AS_REFINED, TRAINED, Metrics, load_metrics
from gva_mi.study.overview import overview
from gva_mi.study.page import Headline, Section, Table, animation, number, picture, plot
from gva_mi.study.pictures import ShownAvatar, dots, picture_sections, turntable
from gva_mi.study.pose_tables import errors_table, pose_headlines
from gva_mi.study.refinement import OVERLAYS
from gva_mi.study.surface import SurfaceFigures

SHOWN = 4  # frames of a split
TURN_FRAMES = 24  # pictures of the turning avatar
SMOOTHED = 25  # steps in a running mean of the curves


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
    """Write the page, and its first picture beside it as a file of its own.

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
    metrics, history = load_metrics(run), run_folder.load_history(run)
    shown = ShownAvatar.of(avatar, video, body)
    write_image(path.with_name(run_folder.OVERVIEW), overview(shown, video))
    width, height = metrics.training.size
    page.write_page(
        path,
        title=title,
        subtitle=f"{subtitle} {width} x {height} pixels, seed {metrics.options['seed']}.",
        headlines=_headlines(metrics),
        sections=[
            *(first or [_turning(avatar, video)]),
            *picture_sections([("", {"render": shown})], SHOWN),
            *_refinement(metrics, video.folder / OVERLAYS),
            *_reinitialisation(run_folder.load_snapshots(run), metrics.surface),
            _curves(history),
            _tables(metrics),
        ],
        settings={
            **settings,
            "options": metrics.options,
            "protocol": metrics.protocol,
            "similarity": metrics.similarity,
            "versions": metrics.versions,
        },
    )


_SURFACE = (
    "Spacing is the coefficient of variation of the distance to the nearest Gaussian on the true "
    "surface: 0 on a lattice, 0.52 for random points. Bias is the 95th percentile of the distance "
    "from the true surface to the nearest Gaussian, stray the 99th of that from a Gaussian to the "
    "surface."
)
_SCORES = (
    "The whole picture on white, then on black, the person's box, and the boxes of visible hands "
    "and faces. LPIPS needs the user's weights; rand_vgg is the same distance in a random network "
    "of a fixed seed, comparable only with itself. A held-out range is a stretch of frames that "
    "training left out; neighbours of single test frames were seen. The run's own poses are "
    "trained on the training frames only; those of a test frame follow from the frames around it, "
    f"‘{AS_REFINED}’ is without that. ‘{ALIGNED}’: one camera shows neither the scale of the world "
    "nor where the skeleton is inside the surface, so the ground truth is transformed to the "
    "avatar's world, once for all frames."
)
_FITTED = (
    f" ‘{FITTED}’ have seen what they are measured on: the avatar is the same, and each pose is "
    "fitted to its own picture."
)


def _headlines(metrics: Metrics) -> list[Headline]:
    """Return pose errors first, because they limit all else; then PSNR, size and time."""
    training, first = metrics.training, metrics.rows[0].name
    minutes, seconds = divmod(round(training.seconds), 60)
    shown = {first: "", ALIGNED: ", world aligned"}
    psnr = {(row.name, row.split, row.region): f"{row.psnr:.1f}" for row in metrics.rows}
    splits = {split for _, split, _ in psnr} - {"train"} or {"train"}
    return [
        *pose_headlines(metrics.refinement),
        *(
            Headline(
                f"{whole} / {psnr.get((name, split, 'person'), '–')} dB",
                f"PSNR, {split.replace('_', ' ')}{shown[name]}: whole picture / person's box",
            )
            for (name, split, region), whole in psnr.items()
            if name in shown and region == "white" and split in splits
        ),
        Headline(f"{training.gaussians:,}", "Gaussians"),
        Headline(f"{minutes} min {seconds:02d} s", f"for {training.steps:,} steps"),
    ]


def _turning(avatar: Avatar, video: Video) -> Section:
    caption = f"{len(avatar.canonical):,} Gaussians, {TURN_FRAMES} views"
    pictures = list(turntable(avatar, video.pose[len(video) // 2], TURN_FRAMES, video.size))
    text = "Fitted to one video of one camera, seen from all around."
    return Section("The avatar", text, [animation(caption, pictures)], columns=3)


def _refinement(metrics: Metrics, overlays: Path) -> list[Section]:
    """Show the refinement's picture and errors, if the subject's folder has the picture."""
    if not overlays.exists():
        return []
    text = "The body over the frames, before the refinement of Eq. 8 (above) and after it (below)."
    if metrics.poses_mm:
        text += " ‘Trained’ poses were corrected by the pictures along with the avatar."
    table = errors_table(metrics.refinement, metrics.poses_mm.get(TRAINED, {}))
    pictures = [picture("stage 1 above, refined below", read_image(overlays, 3))]
    return [Section("Pose refinement", text, pictures, columns=1, tables=[table])]


def _reinitialisation(
    snapshots: Iterable[Snapshot], surface: Sequence[SurfaceFigures]
) -> Iterator[Section]:
    """Show the Gaussians before and after each re-initialisation, and how they lie."""
    pictures = [
        dots(f"step {snapshot.step}, {name}", gaussians)
        for snapshot in snapshots
        for name, gaussians in (("before", snapshot.before), ("after", snapshot.after))
    ]
    if pictures or surface:
        text = (
            "Surface-guided re-initialisation: clumps of Gaussians in textured regions spread, and "
            f"floaters return to the surface. {_SURFACE if surface else ''}"
        )
        tables = [surface_table(surface)] if surface else []
        yield Section("Re-initialisation", text, pictures, columns=2, tables=tables)


def surface_table(surface: Sequence[SurfaceFigures]) -> Table:
    """List how the Gaussians lie on the true surface, a row for each moment of a fit."""
    names = list(dict.fromkeys(name for moment in surface for name in moment.figures))
    digits = {name: 1 if name.endswith("mm") else 2 for name in names}
    rows = [
        (
            f"{moment.step:,}", moment.moment, f"{moment.gaussians:,}",
            *(number(moment.figures.get(name), digits[name]) for name in names),
        )
        for moment in surface
    ]  # fmt: skip
    return Table(("step", "", "Gaussians", *names), rows)


def _curves(history: Mapping[str, np.ndarray]) -> Section:
    """Plot losses and the number of Gaussians over the steps."""
    import matplotlib.pyplot as plt

    fig, (left, right) = plt.subplots(1, 2, figsize=(11, 3.2), layout="constrained")
    steps = np.arange(len(history["loss"]))
    for name, values in history.items():
        is_loss = name not in ("step", "gaussians") and not name.startswith("milliseconds")
        if is_loss and np.any(values):
            left.plot(steps, _smooth(values), label=name, lw=1.2)
    left.set(xlabel="step", title="loss terms, before their weights", yscale="log")
    left.legend(frameon=False, fontsize=8)
    right.plot(steps, history["gaussians"], color="#2f6f5e")
    right.set(xlabel="step", title="Gaussians")
    text = "Each term of Eq. 9, and the number of Gaussians."
    return Section("Training", text, [plot("", fig)], columns=1)


def _smooth(values: np.ndarray) -> np.ndarray:
    """Take a running mean, because the loss of one step depends on its frame."""
    over = min(SMOOTHED, len(values))
    padded = np.pad(values, (over // 2, over - 1 - over // 2), mode="edge")
    return np.convolve(padded, np.full(over, 1 / over), mode="valid")


def _tables(metrics: Metrics) -> Section:
    """List all scores, a table for each region."""
    metric = ("psnr", "ssim", "lpips", "rand_vgg")
    head = ("run", "split", "region", "frames", "PSNR, dB", "SSIM", "LPIPS", *metric[3:])
    order = [(row.name, row.split) for row in metrics.rows if row.region == "white"]
    tables = []
    for region in REGIONS:
        own = [row for row in metrics.rows if row.region == region]
        rows = []
        for row in sorted(own, key=lambda row: order.index((row.name, row.split))):
            names = (row.name.replace("_", " "), row.split.replace("_", " "), region)
            figures = (number(getattr(row, m), 2 if m == "psnr" else 4) for m in metric)
            rows.append((*names, str(row.count), *figures))
        if rows:
            tables.append(Table(head, rows))
    text = _SCORES + (_FITTED if any(row.name == FITTED for row in metrics.rows) else "")
    return Section("Figures", text, tables=tables)
