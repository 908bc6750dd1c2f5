"""The report of a run: what the avatar looks like, how well it does, and how it was trained.

It is made from the run's folder (:mod:`gva_mi.fit.run_folder`) and the subject's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from gva_mi.avatar.avatar import Avatar
from gva_mi.data.pictures import read_image, write_image
from gva_mi.data.video import Video, spread
from gva_mi.fit import run_folder
from gva_mi.fit.evaluation.evaluate import REGIONS, Split, SplitScores, source_of
from gva_mi.fit.evaluation.metrics import ALIGNED, AS_REFINED, TRAINED, Metrics, load_metrics
from gva_mi.fit.evaluation.regions import CLOSE_UPS
from gva_mi.fit.evaluation.report_pictures import (
    compared,
    dots,
    enlarged,
    face,
    hands,
    overview,
    same_size,
    turntable,
)
from gva_mi.fit.evaluation.surface_figures import SurfaceFigures
from gva_mi.fit.evaluation.true_surface import PARTS, TEXTURES
from gva_mi.fit.photometric import FITTED
from gva_mi.fit.run_folder import Snapshot
from gva_mi.page import (
    Figure,
    Section,
    Table,
    animation,
    number,
    picture,
    plot,
    write_page,
)
from gva_mi.pose.evaluation.figures import Change, PoseFigures
from gva_mi.pose.evaluation.record import OVERLAYS

SHOWN = 5  # frames per strip
ENLARGED = 3  # novel poses that are shown enlarged
TURN_FRAMES = 24  # pictures of the turning avatar


def write_report(run: Path, avatar: Avatar, video: Video, title: str) -> None:
    """Write the page, and its first picture on its own.

    Args:
        run: the folder of a run that was evaluated.
        avatar: what was fitted.
        video: opened with the poses that the avatar was trained under.
        title: heading of the page.
    """
    metrics, history = load_metrics(run), run_folder.load_history(run)
    write_image(run / run_folder.OVERVIEW, overview(avatar, video))
    sections = [
        _turning(avatar, video),
        _held_out(avatar, video),
        *_refinement(metrics, video.folder / OVERLAYS),
        *_truth(avatar, video, "novel_pose", "Novel poses", _NOVEL_POSE),
        *_truth(avatar, video, "novel_view", "Novel views", _NOVEL_VIEW),
        *_close_ups(avatar, video),
        *_faces(avatar, video),
        _hands(avatar, video),
        *_reinitialisation(list(run_folder.load_snapshots(run)), metrics.surface),
        _curves(history),
        _tables(metrics),
    ]
    write_page(
        run / run_folder.REPORT,
        title=title,
        subtitle=_subtitle(metrics),
        figures=_figures(metrics),
        sections=sections,
        settings={
            "options": metrics.options,
            "protocol": metrics.protocol and asdict(metrics.protocol),
            "similarity": metrics.similarity,
            "versions": metrics.versions,
            "seed": metrics.seed,
        },
    )


_NOVEL_POSE = "A motion that is not in the video, under its true poses: truth left, render right."
_NOVEL_VIEW = "Poses of the video from cameras that never saw it: truth left, render right."


def _turning(avatar: Avatar, video: Video) -> Section:
    caption = f"{len(avatar.canonical):,} Gaussians, {TURN_FRAMES} views"
    pictures = list(turntable(avatar, video[len(video) // 2], TURN_FRAMES))
    text = "Fitted to one video of one camera, seen all around."
    return Section("The avatar", text, [animation(caption, pictures)], columns=3)


def _held_out(avatar: Avatar, video: Video) -> Section:
    """Frames that training never saw."""
    shown = spread(video.splits.test or video.splits.train, SHOWN + 1)
    images = same_size([compared(avatar, frame) for frame in video.frames(shown)])
    captions = [f"frame {k}: picture · render · difference" for k in shown]
    pictures = [picture(*pair) for pair in zip(captions, images, strict=True)]
    text = (
        "Frames of the video that training left out, cut out by their masks: the picture, the "
        "render, and the largest difference of the three channels (white none, red 64 of 255)."
    )
    return Section("Test frames", text, pictures, columns=3)


def _refinement(metrics: Metrics, overlays: Path) -> list[Section]:
    """The refinement's pictures and figures, where the subject's folder has pictures of it."""
    if not overlays.exists():
        return []
    text = "The body over the frames, before the refinement of Eq. 8 (above) and after it (below)."
    pictures = [picture("stage 1 above, refined below", read_image(overlays, 3))]
    table = _refinement_table(metrics.refinement, metrics.poses_mm.get(TRAINED, {}))
    if metrics.poses_mm:
        text += " ‘Trained’ are the poses that the pictures have corrected along with the avatar."
    return [Section("Pose refinement", text, pictures, columns=1, tables=[table])]


def _refinement_table(figures: PoseFigures, trained: Mapping[str, float]) -> Table:
    """Errors by stage.

    Args:
        figures: of the refinement.
        trained: those of the poses that were trained along, by the names of
            :mod:`gva_mi.pose.evaluation.errors`, millimetres; empty where there are none.
    """

    def row(name: str, change: Change | None, key: str) -> list[str]:
        both = (change.stage1, change.refined) if change else (None, None)
        return [name, *(number(x, 1) for x in (*both, trained.get(key), None))]

    rows = [
        row("vertices, mm", figures.vertices, "body"),
        row("hands, mm", figures.hands, "hands"),
        row("feet, mm", figures.feet, "feet"),
        row("vertices, pelvis on pelvis, mm", figures.aligned, "body_aligned"),
        row("hands, pelvis on pelvis, mm", figures.hands_aligned, "hands_aligned"),
        row("feet, pelvis on pelvis, mm", figures.feet_aligned, "feet_aligned"),
        row("fingers, wrist on wrist, mm", figures.fingers, "fingers"),
        row("ankles too far away, mm", figures.ankles_depth, "ankles_depth"),
        row("wrists too far away, mm", figures.wrists_depth, "wrists_depth"),
    ]
    iou = figures.iou
    overlap = (iou.stage1, iou.refined) if iou else (None, None)
    rows.append(["silhouette IoU", *(number(x, 3) for x in (*overlap, None, figures.iou_truth))])
    return Table(("", "stage 1", "refined", "trained", "true pose"), rows)


def _truth(avatar: Avatar, video: Video, split: Split, title: str, text: str) -> list[Section]:
    """Truth beside render, for a split that not every subject has."""
    source = source_of(video, split)
    if source is None:
        return []
    shown = source.frames(spread(range(len(source)), SHOWN))
    images = same_size([compared(avatar, frame, difference=False) for frame in shown])
    return [Section(title, text, [picture("", image) for image in images])]


def _close_ups(avatar: Avatar, video: Video) -> list[Section]:
    """What goes wrong first in a new pose, enlarged."""
    source = source_of(video, "novel_pose")
    if source is None:
        return []
    frames = source.frames(spread(range(len(source)), ENLARGED))
    pictures = [
        picture(f"novel pose {frame.index}, {name}", image)
        for frame in frames
        for name, image in enlarged(avatar, frame)
    ]
    text = (
        "Novel poses zoomed on head and hair, armpits, hem and hands: the truth's own pixels "
        "above, and below the avatar, rendered at the zoomed resolution."
    )
    return [Section("Closer", text, pictures, columns=len(CLOSE_UPS))] if pictures else []


def _faces(avatar: Avatar, video: Video) -> list[Section]:
    """Faces of test frames, for which the whole body leaves few pixels."""
    frames = video.frames(spread(video.splits.test or video.splits.train, 2 * SHOWN))
    found = [(frame.index, face(avatar, frame)) for frame in frames]
    pictures = [picture(f"frame {k}", image) for k, image in found if image is not None]
    text = (
        "Test frames zoomed on the face: the picture's own pixels above, and below the avatar, "
        "moved by the frame's expression and jaw."
    )
    return [Section("Face", text, pictures, columns=SHOWN)] if pictures else []


def _hands(avatar: Avatar, video: Video) -> Section:
    pictures = [
        picture(f"frame {frame.index}, {side}", image)
        for frame in video.frames(spread(video.splits.test or video.splits.train, SHOWN))
        for side, image in hands(avatar, frame)
    ]
    text = (
        "Test frames zoomed on the hands: the picture's own pixels above, and below the avatar, "
        "rendered at the zoomed resolution."
    )
    return Section("Hands", text, pictures, columns=2 * SHOWN)


def _reinitialisation(
    snapshots: Sequence[Snapshot], surface: Sequence[SurfaceFigures]
) -> list[Section]:
    if not snapshots:
        return []
    pictures = []
    for snapshot in snapshots:
        for name, gaussians in (("before", snapshot.before), ("after", snapshot.after)):
            caption = f"step {snapshot.step}, {name}: {len(gaussians):,} Gaussians"
            pictures.append(picture(caption, dots(gaussians)))
    text = (
        "Surface-guided re-initialisation: every Gaussian as a dot of its own colour, in the rest "
        "pose. Clumps in textured regions spread, and floating Gaussians return to the surface."
    )
    tables = [surface_table(surface)] if surface else []
    if surface:
        text += (
            " Spacing is the coefficient of variation of the distance to the nearest Gaussian on "
            "the true surface: 0 on a lattice, 0.52 for points strewn at random. Bias is the 95th "
            "percentile of the distance from the true surface to the nearest Gaussian, stray the "
            "99th of that from a Gaussian to the surface. Elongation is the 99th percentile of a "
            "Gaussian's length over its breadth."
        )
    return [Section("Re-initialisation", text, pictures, columns=2, tables=tables)]


def surface_table(surface: Sequence[SurfaceFigures]) -> Table:
    """How the Gaussians lie on the true surface, a line for each moment of a fit."""
    textures = [name for name in ("all", *TEXTURES) if any(name in f.spacing for f in surface)]
    parts = [name for name in PARTS if any(name in f.bias_mm for f in surface)]
    head = ("step", "", "Gaussians", *(f"spacing, {name}" for name in textures))
    rows = [
        (
            f"{figures.step:,}",
            figures.moment,
            f"{figures.gaussians:,}",
            *(number(figures.spacing.get(name), 2) for name in textures),
            *(number(figures.bias_mm.get(name), 1) for name in parts),
            number(figures.stray_mm, 1),
            number(figures.elongation, 1),
            number(figures.largest_mm, 0),
        )
        for figures in surface
    ]
    bias = (f"bias of {name}, mm" for name in parts)
    return Table((*head, *bias, "stray, mm", "elongation", "largest, mm"), rows)


_OF_A_STEP = (
    "the frame, cut out and on its background",
    "descent: avatar, splatting, Eq. 9, and all of it back",
    "density control, re-initialisation, what Gaussians follow",
)


def _curves(history: dict[str, np.ndarray]) -> Section:
    """Losses and the number of Gaussians over the steps."""
    import matplotlib.pyplot as plt

    fig, (left, right) = plt.subplots(1, 2, figsize=(11, 3.2), layout="constrained")
    steps = np.arange(len(history["loss"]))
    for name, values in history.items():
        of_a_loss = name not in ("step", "gaussians") and not name.startswith("milliseconds")
        if of_a_loss and np.any(values):
            left.plot(steps, _smooth(values), label=name, lw=1.2)
    left.set(xlabel="step", title="loss terms, before their weights", yscale="log")
    left.legend(frameon=False, fontsize=8)
    right.plot(steps, history["gaussians"], color="#2f6f5e")
    right.set(xlabel="step", title="Gaussians")
    for axis in (left, right):
        axis.spines[["top", "right"]].set_visible(False)
    text, tables = "Each term of Eq. 9, and how many Gaussians.", _time(history)
    if tables:
        text += " Below, what the time went to."
    return Section("Training", text, [plot("", fig)], columns=1, tables=tables)


def _time(history: dict[str, np.ndarray]) -> list[Table]:
    """What a fit's time went to; none of a run whose history does not tell."""
    if any(name not in history for name in run_folder.LAPS):
        return []
    parts = zip(_OF_A_STEP, run_folder.LAPS, strict=True)
    whole, rows = history["milliseconds"].sum(), []
    for title, name in (*parts, ("all", "milliseconds")):
        ms = history[name]
        figures = (number(x, 1) for x in (ms.sum() / 1e3, np.median(ms), ms.mean(), ms.max()))
        rows.append([title, *figures, f"{ms.sum() / whole:.0%}"])
    head = ("", "all steps, s", "a step: median, ms", "mean, ms", "longest, ms", "share")
    return [Table(head, rows)]


def _tables(metrics: Metrics) -> Section:
    head = ("run", "split", "region", "of", "PSNR, dB", "SSIM", "LPIPS", "rand_vgg")
    head += ("spill", "holes", "flicker")
    order = [(row.name, row.split) for row in metrics.rows if row.region == "white"]
    by_region = [[row for row in metrics.rows if row.region == region] for region in REGIONS]
    tables = []
    for rows in filter(None, by_region):
        rows = sorted(rows, key=lambda row: order.index((row.name, row.split)))
        tables.append(Table(head, [_scores(row) for row in rows]))
    text = (
        "Over the whole picture on white, first; then on black, over the person's box, and over "
        "the boxes of hands and faces that are seen. LPIPS needs the user's weights; rand_vgg is "
        "the same distance in a random network of a fixed seed, comparable only with itself. "
        "Spill is what the avatar covers beside the person, holes what it leaves open within, and "
        "flicker what changes in it, and not in the person, since the frame before, as shares of "
        "the person. "
        "Poses are trained on the training frames alone; those of a test frame follow "
        f"from the frames around. ‘{AS_REFINED}’ are the same frames without it. ‘{ALIGNED}’: one "
        "camera tells neither how large the world is nor where in its surface the skeleton stands; "
        "the truth is laid over the avatar's world, once for all frames."
    )
    if any(row.name == FITTED for row in metrics.rows):
        text += (
            " ‘Poses fitted to the pictures’ have seen what they are measured on: the avatar is "
            "the same, and each pose is fitted to its very picture; those of novel poses and "
            "views start from the true ones after the similarity transform."
        )
    return Section("Figures", text, tables=tables)


def _scores(row: SplitScores) -> tuple[str, ...]:
    names = (row.name.replace("_", " "), row.split.replace("_", " "), row.region)
    figures = ((row.psnr, 2), (row.ssim, 4), (row.lpips, 4), (row.rand_vgg, 4))
    figures += ((row.spill, 4), (row.holes, 4), (row.flicker, 4))
    return (*names, str(row.count), *(number(value, digits) for value, digits in figures))


def _figures(metrics: Metrics) -> list[Figure]:
    """The large numbers at the top."""
    psnr = {
        row.split: row.psnr
        for row in metrics.rows
        if row.name == metrics.rows[0].name and row.region == "white"
    }
    figures = [
        Figure(f"{psnr[split]:.1f} dB", f"PSNR, {split.replace('_', ' ')}")
        for split in ("test", "novel_pose", "novel_view")
        if split in psnr
    ]
    vertices, iou, training = metrics.refinement.vertices, metrics.refinement.iou, metrics.training
    if vertices is not None:
        value = f"{vertices.stage1:.0f} → {vertices.refined:.0f} mm"
        figures.append(Figure(value, "mean vertex error, stage 1 → refined"))
    if iou is not None:
        value = f"{iou.stage1:.3f} → {iou.refined:.3f}"
        figures.append(Figure(value, "silhouette IoU, stage 1 → refined"))
    figures.append(Figure(f"{training.gaussians:,}", "Gaussians"))
    minutes, seconds = divmod(round(training.seconds), 60)
    figures.append(Figure(f"{minutes} min {seconds:02d} s", f"for {training.steps:,} steps"))
    return figures


def _subtitle(metrics: Metrics) -> str:
    width, height = metrics.training.size
    return (
        f"A 3D Gaussian avatar of body and hands from a monocular video, {width} x {height} "
        f"pixels, seed {metrics.seed}."
    )


def _smooth(values: np.ndarray, over: int = 25) -> np.ndarray:
    """A running mean: the loss of a single step depends on which frame it showed."""
    over = min(over, len(values))
    padded = np.pad(values, (over // 2, over - 1 - over // 2), mode="edge")
    return np.convolve(padded, np.full(over, 1 / over), mode="valid")
