"""The report of a refinement: how far the poses are off, frame by frame, and what helps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch

from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.console import listed
from gva_mi.data.video import Frame, Video, spread
from gva_mi.mesh.overlay import overlay, shaded, strip
from gva_mi.page import (
    Figure,
    Section,
    Table,
    around,
    number,
    picture,
    plot,
    write_page,
)
from gva_mi.pose.evaluation.figures import Change, PoseFigures
from gva_mi.pose.evaluation.measure import Evaluation, Measured
from gva_mi.pose.refine import Refined
from gva_mi.splat import Camera

WORST, SPREAD = 6, 6  # frames shown
BEFORE, AFTER, TRUTH = "#b3261e", "#2f6f5e", "#667085"  # colours of curves


def write_report(
    path: Path,
    evaluation: Evaluation,
    *,
    title: str,
    versions: Mapping[str, str],
    ablation: Mapping[str, PoseFigures] | None = None,
) -> None:
    """Write the page.

    Args:
        path: the ``.html`` file.
        evaluation: of the refinement.
        title: its heading.
        versions: of what may change the figures.
        ablation: the same figures for variants of the refinement, by name.
    """
    video, refined, measured = evaluation.video, evaluation.refined, evaluation.measured
    worst = _worst(video, measured)
    there = [k for k in range(len(video)) if k not in video.absent]
    sections = [
        _means(measured.means),
        _curves(refined, measured),
        _frames("Worst frames", _WORST, worst, evaluation),
        _frames("All along", _ALONG, spread(there, SPREAD), evaluation),
        *([_ablation(measured.means, ablation)] if ablation else []),
        *([_surface(evaluation.body, refined)] if refined.offsets.any() else []),
        *_exceptions(refined),
    ]
    write_page(
        path,
        title=title,
        subtitle=_subtitle(evaluation),
        figures=_figures(measured.means, refined),
        sections=sections,
        settings={"options": asdict(evaluation.options), "versions": dict(versions)},
    )


_WORST = (
    "The frames in which the refined body is farthest from the truth or, where no truth is known, "
    "covers its mask least."
)
_ALONG = "Evenly spaced frames of the video."
_ABLATION = (
    "The same video refined with a part left out, and by Eq. 8 as the paper prints it: every frame "
    "for itself, the bare body, rotations alone. Nothing else differs. A bare body cannot fill the "
    "mask of a clothed person: what lies nearest to the mask is not what lies nearest to the truth."
)
_KEPT = "These frames keep the pose that stage 1 gave them."


def _subtitle(evaluation: Evaluation) -> str:
    width, height = evaluation.video.size
    return (
        f"Poses of {len(evaluation.video)} frames of {width} x {height} pixels made to agree with "
        f"normals and silhouettes: {evaluation.options.description}."
    )


def _figures(means: PoseFigures, refined: Refined) -> list[Figure]:
    figures = []
    for label, change in (("mean vertex error", means.vertices), ("hands", means.hands)):
        if change is not None:
            value = f"{change.stage1:.0f} → {change.refined:.0f} mm"
            figures.append(Figure(value, f"{label}, stage 1 → refined"))
    own = "" if means.iou_truth is None else f" ({means.iou_truth:.3f} at the true pose)"
    iou = f"{means.iou.stage1:.3f} → {means.iou.refined:.3f}"
    figures.append(Figure(iou, "silhouette IoU" + own))
    figures.append(Figure(f"{refined.seconds_per_frame:.2f} s", "of work for a frame"))
    figures.append(Figure(str(len(refined.kept)), "frames keep their stage-1 pose"))
    return figures


def _means(means: PoseFigures) -> Section:
    """Stage 1, refined and truth side by side."""
    iou = means.iou
    rows = [
        *_lengths(means),
        *_depths(means),
        (
            "silhouette IoU of the bare body",
            number(iou.stage1, 3),
            number(iou.refined, 3),
            f"{iou.refined - iou.stage1:+.3f}",
            number(means.iou_truth, 3),
        ),
    ]
    grew = [
        f"{100 * share:.0f} % of all frames in {region}"
        for region, share in (("body", means.frames_worse), ("hands", means.frames_worse_hands))
        if share is not None
    ]
    text = (
        f"Means over all frames. Errors are distances of {means.points} from where they truly are; "
        "those of the fingers are taken after the wrist was put where it is. Depths are signed: "
        "above zero is too far away."
    )
    if grew:
        text += f" The error grew against stage 1 in {' and '.join(grew)}."
    else:
        text = "Means over all frames. The truth is not known: only the masks can tell."
    return Section(
        "Figures", text, tables=[Table(("", "stage 1", "refined", "change", "true pose"), rows)]
    )


def _lengths(means: PoseFigures) -> list[tuple[str, ...]]:
    """Rows of the errors that are known: stage 1, refined, change, and a dash for the truth."""
    rows = []
    for name, change in (
        (f"{means.points}, mm", means.vertices),
        ("hands, mm", means.hands),
        ("feet, mm", means.feet),
        ("fingers, wrist on wrist, mm", means.fingers),
        (f"{means.points}, root-aligned, mm", means.aligned),
        ("hands, root-aligned, mm", means.hands_aligned),
        ("feet, root-aligned, mm", means.feet_aligned),
        ("joints of the body, mm", means.joints),
        ("distance of the surfaces, mm", means.surface),
        ("of those of the hands, mm", means.hands_surface),
        ("of those of the feet, mm", means.feet_surface),
    ):
        if change is not None:
            both = number(change.stage1, 1), number(change.refined, 1)
            rows.append((name, *both, _percent(change), "–"))
    return rows


def _depths(means: PoseFigures) -> list[tuple[str, ...]]:
    """Rows of signed errors, whose change is no share of what they were."""
    rows = []
    for name, change in (
        ("depth of the pelvis, mm", means.pelvis_depth),
        ("depth of the ankles, mm", means.ankles_depth),
        ("depth of the wrists, mm", means.wrists_depth),
    ):
        if change is not None:
            grew = change.refined - change.stage1
            rows.append((name, *(f"{x:+.1f}" for x in (change.stage1, change.refined, grew)), "–"))
    return rows


def _percent(change: Change) -> str:
    return "–" if change.relative is None else f"{100 * change.relative:+.0f} %"


def _curves(refined: Refined, measured: Measured) -> Section:
    """Errors, IoU and loss over the frames."""
    import matplotlib.pyplot as plt

    known = measured.refined is not None
    panels = [("silhouette IoU", measured.iou_stage1, measured.iou, measured.iou_truth)]
    panels.append(("loss: normals + λ1 silhouette", refined.losses_stage1, refined.losses, None))
    for region in ("fingers", "feet", "hands", "body") if known else ():
        before, after = getattr(measured.stage1, region), getattr(measured.refined, region)
        panels.insert(0, (f"{region}, mm", before, after, None))
    fig, axes = plt.subplots(len(panels), 1, figsize=(11, 1.7 * len(panels)), sharex=True)
    for axis, (title, before, after, truth) in zip(axes, panels, strict=True):
        axis.plot(before, color=BEFORE, lw=1.2, label="stage 1")
        axis.plot(after, color=AFTER, lw=1.6, label="refined")
        if truth is not None:
            axis.plot(truth, color=TRUTH, lw=1, ls="--", label="true pose")
        for k in refined.kept:
            axis.axvspan(k - 0.5, k + 0.5, color="#e4e7ec", lw=0)
        axis.set_title(title, loc="left", fontsize=9)
        axis.spines[["top", "right"]].set_visible(False)
        if "IoU" not in title:
            axis.set_ylim(bottom=0)
    axes[-1].set_xlabel("frame")
    named = axes[-2]  # the IoU, in which all of them are drawn
    named.legend(frameon=False, fontsize=8, ncols=3, loc="lower right", bbox_to_anchor=(1, 0.98))
    fig.tight_layout()
    text = "Grey bars are frames that keep their stage-1 pose." if refined.kept else ""
    return Section("Frame by frame", text, [plot("", fig)], columns=1)


def _worst(video: Video, measured: Measured) -> list[int]:
    """The frames with the largest errors, or the smallest IoU, the worst first."""
    badness = measured.refined.body if measured.refined is not None else -measured.iou
    order = badness.nan_to_num(-torch.inf).argsort(descending=True, stable=True).tolist()
    return [k for k in order if k not in video.absent][:WORST]


@torch.no_grad()
def _frames(title: str, text: str, shown: list[int], evaluation: Evaluation) -> Section:
    """Overlays of some frames, all poses of a frame side by side."""
    video, body, refined = evaluation.video, evaluation.body, evaluation.refined
    cameras, truth = refined.cameras or video.cameras, evaluation.truth
    people = {
        "stage 1": (body, video.pose, video.shape, video.cameras),
        "refined": (body, refined.pose, refined.shape, cameras),
    }
    if truth is not None:
        people["true pose"] = (truth.body, truth.pose, truth.shape, truth.cameras)
    pictures = []
    seen = np.any([outline.mask > 0.5 for outline in video.outlines(shown)], axis=0)
    part = around(seen, margin=len(seen) // 12)
    for frame in video.frames(shown):
        panels = [_overlay(frame, *person)[part] for person in people.values()]
        caption = f"frame {frame.index}: {_caption(frame.index, evaluation.measured)}"
        pictures.append(picture(caption, strip([[frame.image[part], *panels]])))
    text += f" From left to right: the picture, {', '.join(people)}."
    return Section(title, text, pictures, columns=3)


def _overlay(
    frame: Frame, body: BodyModel, pose: Pose, shape: Shape, cameras: Sequence[Camera]
) -> np.ndarray:
    vertices = body(pose[frame.index], shape).vertices[0]
    return overlay(frame.image, cameras[frame.index], vertices, body.faces)


def _caption(frame: int, measured: Measured) -> str:
    """A frame's own figures."""
    parts = []
    if measured.refined is not None:
        for name in ("body", "hands"):
            before, after = (getattr(e, name)[frame] for e in (measured.stage1, measured.refined))
            parts.append(f"{name} {before:.0f} → {after:.0f} mm")
    parts.append(f"IoU {measured.iou_stage1[frame]:.2f} → {measured.iou[frame]:.2f}")
    return ", ".join(parts)


def _ablation(means: PoseFigures, ablation: Mapping[str, PoseFigures]) -> Section:
    head = (
        "", "vertices, mm", "hands, mm", "feet, mm", "root-aligned, mm", "frames worse", "IoU",
        "s a frame",
    )  # fmt: skip
    rows = [("stage 1", *_cells(means, "stage1"))]
    rows += [
        (name, *_cells(figures, "refined"))
        for name, figures in {"refined": means, **ablation}.items()
    ]
    return Section("What each term is worth", _ABLATION, tables=[Table(head, rows)])


def _cells(figures: PoseFigures, stage: str) -> list[str]:
    """A row of the ablation's table: the figures of ``"stage1"`` or ``"refined"``."""
    lengths = (figures.vertices, figures.hands, figures.feet, figures.aligned)
    cells = ["–" if change is None else number(getattr(change, stage), 1) for change in lengths]
    worse = figures.frames_worse if stage == "refined" else None
    seconds = figures.seconds_per_frame if stage == "refined" else None
    cells.append("–" if worse is None else f"{100 * worse:.0f} %")
    return [*cells, number(getattr(figures.iou, stage), 3), number(seconds, 2)]


def _surface(body: BodyModel, refined: Refined) -> Section:
    """The rest surface, bare and displaced."""
    bare = body.rest(refined.shape).vertices
    rows = [
        [shaded(x, body.faces, angle) for angle in (0.0, np.pi / 2, np.pi)]
        for x in (bare, bare + refined.offsets)
    ]
    part = around(np.any([image.min(-1) < 1 for row in rows for image in row], axis=0), 4)
    length = 1e3 * refined.offsets.norm(dim=1)
    text = (
        "The rest surface of the body (above) and with the displacement that stands for clothes "
        f"and hair (below): {length.mean():.0f} mm in the mean, {length.max():.0f} mm at most. It "
        "is shared by all frames and stored with the poses."
    )
    pictures = [picture("", strip([[image[part] for image in row] for row in rows]))]
    return Section("The surface that is seen", text, pictures, columns=2)


def _exceptions(refined: Refined) -> list[Section]:
    """Frames that were not refined, or not like the others."""
    sections = []
    if refined.kept:
        rows = [(str(k), reason) for k, reason in refined.kept.items()]
        sections.append(Section("Kept frames", _KEPT, tables=[Table(("frame", "why"), rows)]))
    for limbs, frames in refined.swapped.items():
        text = f"Stage 1 took the left for the right in frames {listed(frames)}."
        sections.append(Section(f"Exchanged {limbs}", text))
    if refined.held_out:
        numbers = ", ".join(map(str, refined.held_out))
        text = f"Their pictures were not looked at; their poses follow from the others: {numbers}."
        sections.append(Section("Test frames that were held out", text))
    if refined.without_normals:
        numbers = ", ".join(map(str, refined.without_normals))
        text = f"They were fitted to their silhouettes alone: {numbers}."
        sections.append(Section("Frames without normals", text))
    return sections
