"""The report of a refinement: pose errors frame by frame, and overlays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict

import torch

from gva_mi.core.console import listed
from gva_mi.data.video import Video, spread
from gva_mi.mesh.overlay import strip
from gva_mi.pose.refine import Refined
from gva_mi.study.measure import ERRORS, Evaluation, FrameFigures, PoseFigures
from gva_mi.study.page import Headline, Section, Table, number, picture, plot, write_page
from gva_mi.study.refinement import PAGE, overlays

SHOWN = 6  # frames of a strip
BEFORE, AFTER, TRUTH = "#b3261e", "#2f6f5e", "#667085"  # colours of curves

LENGTHS = {  # titles of errors in tables
    "body_aligned": "{points}, pelvis-aligned",
    "hands_aligned": "hands, pelvis-aligned",
    "feet_aligned": "feet, pelvis-aligned",
    "body": "{points}, absolute",
    "hands": "hands, absolute",
    "feet": "feet, absolute",
    "fingers": "fingers, wrist-aligned",
    "joints": "joints of the body",
    "surface": "distance of the surfaces",
    "hands_surface": "distance of the hands' surfaces",
    "feet_surface": "distance of the feet's surfaces",
}
DEPTHS = {
    "pelvis_depth": "depth of the pelvis",
    "ankles_depth": "depth of the ankles",
    "wrists_depth": "depth of the wrists",
}


def write_refinement_report(evaluation: Evaluation, versions: Mapping[str, str]) -> None:
    """Write the page into the subject's folder; ``versions``: of what may change the figures."""
    video, refined, measured = evaluation.video, evaluation.refined, evaluation.measured
    there = [k for k in range(len(video)) if k not in video.absent]
    width, height = video.size
    write_page(
        video.folder / PAGE,
        title=f"Poses of {video.folder.name}",
        subtitle=(
            f"Poses of {len(video)} frames of {width} x {height} pixels, refined to agree with "
            f"normals and silhouettes: {evaluation.options.description}."
        ),
        headlines=_headlines(measured.means, refined),
        sections=[
            _means(measured.means),
            _curves(refined, measured),
            _frames("Worst frames", "Worst first.", _worst(video, measured), evaluation),
            _frames("Evenly spaced frames", "", spread(there, SHOWN), evaluation),
            *_exceptions(refined),
        ],
        settings={"options": asdict(evaluation.options), "versions": dict(versions)},
    )


def errors_table(figures: PoseFigures, trained: Mapping[str, float] | None = None) -> Table:
    """List the known errors at stage 1 and after refinement.

    Args:
        figures: of the refinement.
        trained: errors of poses trained with the avatar, by the names of
            :mod:`gva_mi.pose.errors`, millimetres; None: no such column.
    """
    rows, further = [], lambda text: [] if trained is None else [text]
    for name, title in (LENGTHS | DEPTHS).items():
        change, later, signed = figures.change(name), (trained or {}).get(name), name in DEPTHS
        if change is None and later is None:
            continue
        values = ("–", "–", "–")
        if change is not None:
            share = None if signed else figures.relative(name)
            grew = number(change[1] - change[0], 1, sign=True)
            grew = grew if share is None else f"{100 * share:+.0f} %"
            values = (*(number(x, 1, signed) for x in change), grew)
        title = title.format(points=figures["points"] or "vertices")
        rows.append([f"{title}, mm", *values, *further(number(later, 1, signed)), "–"])
    if iou := figures.change("iou"):
        values = (number(x, 3) for x in iou)
        grew, limit = number(iou[1] - iou[0], 3, sign=True), figures["iou_truth"]
        rows.append(["silhouette IoU", *values, grew, *further("–"), number(limit, 3)])
    head = ("", "stage 1", "refined", "change", *further("trained"), "ground-truth pose")
    return Table(head, rows)


def pose_headlines(figures: PoseFigures) -> list[Headline]:
    """Return the errors of poses, first those without depth."""
    titles = {
        "body_aligned": "pelvis-aligned error, stage 1 → refined",
        "hands_aligned": "pelvis-aligned, of the hands",
        "feet_aligned": "pelvis-aligned, of the feet",
        "pelvis_depth": "depth of the pelvis, which one camera shows only with height and lens",
    }
    return [
        Headline(f"{both[0]:{sign}.0f} → {both[1]:{sign}.0f} mm", label)
        for name, label in titles.items()
        for sign in ("+" if name in DEPTHS else "",)
        if (both := figures.change(name))
    ]


def _headlines(means: PoseFigures, refined: Refined) -> list[Headline]:
    before, after = means.change("iou")
    return [
        *pose_headlines(means),
        Headline(f"{before:.3f} → {after:.3f}", "silhouette IoU"),
        Headline(f"{refined.seconds_per_frame:.2f} s", "of work for a frame"),
        Headline(str(len(refined.kept)), "frames keep their stage-1 pose"),
    ]


def _means(means: PoseFigures) -> Section:
    if means["frames_worse"] is None:
        text = "Means over all frames. Without ground truth, only the masks can tell."
    else:
        aligned, body, hands = (
            100 * (means[f"frames_worse{part}"] or 0) for part in ("_aligned", "", "_hands")
        )
        text = (
            f"Means over all frames. Errors are distances of {means['points']} from the ground "
            "truth. Depths are signed: above zero is too far away. The error increased against "
            f"stage 1 in {body:.0f} % of all frames, without the place of the pelvis in "
            f"{aligned:.0f} %, that of the hands in {hands:.0f} %."
        )
    return Section("Figures", text, tables=[errors_table(means)])


def _curves(refined: Refined, measured: FrameFigures) -> Section:
    """Plot errors, IoU and loss over the frames."""
    import matplotlib.pyplot as plt

    frames, panels = measured.frames, []
    for region in ("body", "hands", "feet", "fingers"):
        if (key := ERRORS[region]) in frames:
            panels.append((f"{region}, mm", frames[f"{key}_stage1"], frames[key], None))
    panels += [
        ("silhouette IoU", frames["iou_stage1"], frames["iou"], frames.get("iou_truth")),
        ("loss: normals + λ1 silhouette", refined.losses_stage1, refined.losses, None),
    ]
    fig, axes = plt.subplots(len(panels), 1, figsize=(11, 1.7 * len(panels)), sharex=True)
    for axis, (title, before, after, truth) in zip(axes, panels, strict=True):
        axis.plot(before, color=BEFORE, lw=1.2, label="stage 1")
        axis.plot(after, color=AFTER, lw=1.6, label="refined")
        if truth is not None:
            axis.plot(truth, color=TRUTH, lw=1, ls="--", label="ground-truth pose")
        for k in refined.kept:
            axis.axvspan(k - 0.5, k + 0.5, color="#e4e7ec", lw=0)
        axis.set_title(title, loc="left", fontsize=9)
        if "IoU" not in title:
            axis.set_ylim(bottom=0)
    axes[-1].set_xlabel("frame")
    iou = axes[-2]  # has all three curves
    iou.legend(frameon=False, fontsize=8, ncols=3, loc="lower right", bbox_to_anchor=(1, 0.98))
    fig.tight_layout()
    text = "Grey bars are frames that keep their stage-1 pose." if refined.kept else ""
    return Section("Frame by frame", text, [plot("", fig)], columns=1)


def _worst(video: Video, measured: FrameFigures) -> list[int]:
    """Return the frames with the largest body errors, or else the smallest IoU, worst first."""
    badness = measured.frames.get("vertex_mm", -measured.frames["iou"])
    order = badness.nan_to_num(-torch.inf).argsort(descending=True, stable=True).tolist()
    return [k for k in order if k not in video.absent][:SHOWN]


def _frames(title: str, text: str, shown: Sequence[int], evaluation: Evaluation) -> Section:
    """Show overlays of some frames, all poses of a frame side by side."""
    pictures, names = [], ()
    for k, panels in overlays(evaluation, shown):
        caption = f"frame {k}: {_caption(k, evaluation.measured)}"
        pictures.append(picture(caption, strip([list(panels.values())])))
        names = panels
    text = f"{text} From left to right: {', '.join(names)}.".strip()
    return Section(title, text, pictures, columns=3)


def _caption(frame: int, measured: FrameFigures) -> str:
    """Write a frame's own figures."""
    known = {key: float(x[frame]) for key, x in measured.frames.items()}
    parts = [
        f"{name} {known[f'{key}_stage1']:.0f} → {known[key]:.0f} mm"
        for name, key in (("body", "vertex_mm"), ("hands", "hand_vertex_mm"))
        if key in known
    ]
    return ", ".join([*parts, f"IoU {known['iou_stage1']:.2f} → {known['iou']:.2f}"])


def _exceptions(refined: Refined) -> list[Section]:
    """List frames that were not refined, or refined differently."""
    rows = [(str(k), f"keeps the pose of stage 1: {why}") for k, why in refined.kept.items()]
    rows += [(listed(k), f"{x}: left and right exchanged") for x, k in refined.swapped.items()]
    for frames, what in (
        (refined.held_out, "held-out test frames: poses follow from the other frames"),
        (refined.without_normals, "no normals: fitted to silhouettes alone"),
    ):
        rows += [(listed(frames), what)] if frames else []
    table = Table(("frames", "what differs"), rows, words=True)
    return [Section("Frames that differ", "", tables=[table])] if rows else []
