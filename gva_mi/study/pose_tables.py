"""Pose errors before and after the refinement, as a table and as the large numbers of a page."""

from __future__ import annotations

from collections.abc import Mapping

from gva_mi.study.measure import PoseFigures
from gva_mi.study.page import Headline, Table, number

LENGTHS = {  # titles of errors in tables
    "body_aligned": "{points}, pelvis-aligned",
    "hands_aligned": "hands, pelvis-aligned",
    "feet_aligned": "feet, pelvis-aligned",
    "body": "{points}, absolute",
    "hands": "hands, absolute",
    "feet": "feet, absolute",
    "fingers": "fingers, wrist-aligned",
    "joints": "joints of the body",
}
DEPTHS = {
    "pelvis_depth": "depth of the pelvis",
    "ankles_depth": "depth of the ankles",
    "wrists_depth": "depth of the wrists",
}


def errors_table(figures: PoseFigures, trained: Mapping[str, float]) -> Table:
    """List the known errors at stage 1 and after refinement.

    Args:
        figures: of the refinement.
        trained: errors of poses trained with the avatar, by the names of
            :mod:`gva_mi.pose.errors`, millimetres.
    """
    rows = []
    for name, title in (LENGTHS | DEPTHS).items():
        change, later, signed = figures.change(name), trained.get(name), name in DEPTHS
        if change is None and later is None:
            continue
        values = ("–", "–", "–")
        if change is not None:
            share = None if signed else figures.relative(name)
            grew = number(change[1] - change[0], 1, sign=True)
            grew = grew if share is None else f"{100 * share:+.0f} %"
            values = (*(number(x, 1, signed) for x in change), grew)
        title = title.format(points=figures["points"] or "vertices")
        rows.append([f"{title}, mm", *values, number(later, 1, signed), "–"])
    if iou := figures.change("iou"):
        values = (number(x, 3) for x in iou)
        grew, limit = number(iou[1] - iou[0], 3, sign=True), figures["iou_truth"]
        rows.append(["silhouette IoU", *values, grew, "–", number(limit, 3)])
    head = ("", "stage 1", "refined", "change", "trained", "ground-truth pose")
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
