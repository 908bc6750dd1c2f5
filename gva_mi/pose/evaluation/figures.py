"""The figures of a refinement: means over frames, as files and pages hold them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Literal

from gva_mi import records


@dataclass(frozen=True)
class Change:
    """A figure of stage 1, and the same of the refined poses."""

    stage1: float
    refined: float

    @property
    def relative(self) -> float | None:
        """-0.5 where it was halved; None where there was nothing to change."""
        return self.refined / self.stage1 - 1 if self.stage1 else None


@dataclass(frozen=True)
class PoseFigures:
    """Means over frames; None where a figure needs the truth and there is none.

    What each of them measures is said in :mod:`gva_mi.pose.evaluation.errors`; "vertices" are its
    points, which of a foreign body are joints.
    """

    vertices: Change | None = None  # mm
    hands: Change | None = None  # mm
    feet: Change | None = None  # mm
    aligned: Change | None = None  # of all vertices, root-aligned, mm
    hands_aligned: Change | None = None  # mm
    feet_aligned: Change | None = None  # mm
    fingers: Change | None = None  # in the frame of the wrist, mm
    joints: Change | None = None  # mm
    joints_aligned: Change | None = None  # mm
    pelvis_depth: Change | None = None  # mm, above 0: too far away
    ankles_depth: Change | None = None  # mm, likewise
    wrists_depth: Change | None = None  # mm, likewise
    surface: Change | None = None  # mm; None where the true body is the fitted one
    hands_surface: Change | None = None  # mm, likewise
    feet_surface: Change | None = None  # mm, likewise
    points: Literal["vertices", "joints"] | None = None  # that all but the surfaces are measured on
    frames_worse: float | None = None  # share of frames whose vertex error grew
    frames_worse_hands: float | None = None  # share of frames whose hand error grew
    iou: Change | None = None  # None where no refinement was measured
    iou_truth: float | None = None  # of the true pose
    iou_true_masks: float | None = None  # of the refined pose with the masks of the truth
    focal: Change | None = None  # focal length over the true one, minus 1
    seconds_per_frame: float | None = None

    def lines(self) -> Iterator[str]:
        """The main figures, a line each; those that take the truth where it is known.

        "Aligned" are the vertices after the pelvis was laid on the true one; the signs of depths
        say whether ankles and wrists are too far away (+) or too near.
        """
        for name, change in (
            (self.points or "vertices", self.vertices),
            ("hands", self.hands),
            ("feet", self.feet),
            ("aligned", self.aligned),
            ("fingers", self.fingers),
            ("surface", self.surface),
        ):
            if change is not None:
                yield f"{name:<11} {change.stage1:.1f} → {change.refined:.1f} mm"
        if self.ankles_depth is not None and self.wrists_depth is not None:
            ankles, wrists = (
                f"{name} {change.stage1:+.0f} → {change.refined:+.0f} mm"
                for name, change in (("ankles", self.ankles_depth), ("wrists", self.wrists_depth))
            )
            yield f"depth       {ankles}, {wrists}"
        if self.frames_worse is not None:
            worse = f"{self.frames_worse:.0%} of the frames"
            yield f"worse       {worse}, in the hands {self.frames_worse_hands:.0%}"
        if self.focal is not None and self.focal.stage1:
            yield f"focal       {self.focal.stage1:+.1%} → {self.focal.refined:+.1%} off"
        if self.iou is not None:
            truth = self.iou_truth
            own = f" (true pose {truth:.3f})" if truth is not None else ""
            yield f"silhouette  IoU {self.iou.stage1:.3f} → {self.iou.refined:.3f}{own}"

    def to_json(self) -> dict[str, float | str | None]:
        """The keys of ``refinement.json`` and ``metrics.json``; see :meth:`from_json`."""
        record = {}
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name in _CHANGES:
                key = _CHANGES[field.name]
                record[f"{key}_stage1"] = None if value is None else value.stage1
                record[key] = None if value is None else value.refined
            else:
                record[field.name] = value
        return record

    @staticmethod
    def from_json(record: Mapping[str, float | str | None]) -> PoseFigures:
        """What :meth:`to_json` wrote; figures that are missing are None."""
        figures = {}
        for field in fields(PoseFigures):
            if field.name in _CHANGES:
                key = _CHANGES[field.name]
                both = {"stage1": record.get(f"{key}_stage1"), "refined": record.get(key)}
                figures[field.name] = None if None in both.values() else both
            else:
                figures[field.name] = record.get(field.name)
        return records.from_json(PoseFigures, figures)


_CHANGES = {  # the key of the refined figure in JSON; that of stage 1 has "_stage1" after it
    "vertices": "vertex_mm",
    "hands": "hand_vertex_mm",
    "feet": "foot_vertex_mm",
    "aligned": "aligned_vertex_mm",
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
    "iou": "iou",
    "focal": "focal_error",
}
