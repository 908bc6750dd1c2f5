"""Figures of a pose refinement under their JSON keys: frame by frame, and means over frames."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

# Keys in JSON of the errors of gva_mi.pose.errors; the value of stage 1 has "_stage1" appended.
ERRORS = {
    "body": "vertex_mm",
    "hands": "hand_vertex_mm",
    "feet": "foot_vertex_mm",
    "body_aligned": "aligned_vertex_mm",
    "hands_aligned": "aligned_hand_vertex_mm",
    "feet_aligned": "aligned_foot_vertex_mm",
    "fingers": "finger_mm",
    "joints": "joint_mm",
    "joints_aligned": "aligned_joint_mm",
    "pelvis_depth": "pelvis_depth_mm",
    "ankles_depth": "ankle_depth_mm",
    "wrists_depth": "wrist_depth_mm",
    "surface": "surface_mm",
    "hands_surface": "hand_surface_mm",
    "feet_surface": "foot_surface_mm",
}
KEYS = (
    *(name for key in ERRORS.values() for name in (f"{key}_stage1", key)),
    "points", "frames_worse", "frames_worse_hands", "iou_stage1", "iou", "iou_truth",
    "iou_true_masks", "focal_error_stage1", "focal_error", "seconds_per_frame",
)  # fmt: skip


@dataclass(frozen=True)
class PoseFigures:
    """Figures by the keys of ``refinement.json``; a missing one is None.

    ``*_mm`` are errors of :mod:`gva_mi.pose.errors`, taken on ``points`` ("vertices" or "joints");
    ``frames_worse`` is the share of frames whose error increased; ``iou`` compares the bare body
    with the masks, ``iou_truth`` the ground-truth body, ``iou_true_masks`` the refined body with
    the true masks; ``focal_error`` is relative.
    """

    values: Mapping[str, Any] = field(default_factory=dict)

    def __getitem__(self, key: str) -> Any:  # noqa: ANN401
        return self.values.get(key)

    def change(self, name: str) -> tuple[Any, Any] | None:
        """Return a figure at stage 1 and after refinement; ``name`` of ERRORS, or a key."""
        key = ERRORS.get(name, name)
        both = self[f"{key}_stage1"], self[key]
        return None if any(x is None for x in both) else both

    def relative(self, name: str) -> float | None:
        """Return the relative change of a figure, -0.5 if it was halved; None if it was 0."""
        before, after = self.change(name) or (0, 0)
        return after / before - 1 if before else None

    def lines(self) -> Iterator[str]:
        """Yield the main figures, a line each, for the console."""
        titles = {"body": self["points"] or "vertices", "body_aligned": "aligned"}
        for name in ("body", "hands", "feet", "body_aligned", "fingers", "surface"):
            if both := self.change(name):
                yield f"{titles.get(name, name):<11} {both[0]:.1f} → {both[1]:.1f} mm"
        depths = {limb: self.change(f"{limb}_depth") for limb in ("ankles", "wrists")}
        if all(depths.values()):
            texts = (f"{limb} {a:+.0f} → {b:+.0f} mm" for limb, (a, b) in depths.items())
            yield f"depth       {', '.join(texts)}"
        if self["frames_worse"] is not None:
            body, hands = self["frames_worse"], self["frames_worse_hands"]
            yield f"increased   error in {body:.0%} of the frames, of the hands in {hands:.0%}"
        focal, iou, limit = self.change("focal_error"), self.change("iou"), self["iou_truth"]
        if focal and focal[0]:
            yield f"focal       {focal[0]:+.1%} → {focal[1]:+.1%} off"
        if iou:
            best = "" if limit is None else f" (ground-truth pose {limit:.3f})"
            yield f"silhouette  IoU {iou[0]:.3f} → {iou[1]:.3f}{best}"

    def to_json(self) -> dict[str, float | str | None]:
        """Return every key, in the order of the files."""
        return {key: self[key] for key in KEYS}

    @staticmethod
    def from_json(record: Mapping[str, Any]) -> PoseFigures:
        """Read what :meth:`to_json` wrote; missing figures are None.

        Raises:
            TypeError: a figure is not a number.
        """
        values = {key: record.get(key) for key in KEYS}
        for key, value in values.items():
            kind = str if key == "points" else int | float
            if value is not None and (isinstance(value, bool) or not isinstance(value, kind)):
                raise TypeError(f"'{key}' is {value!r:.40}")
        return PoseFigures(values)
