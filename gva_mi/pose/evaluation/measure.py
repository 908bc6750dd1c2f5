"""How well poses fit, told by the truth of a synthetic subject; no step reads it.

Means over all frames of what :mod:`gva_mi.pose.evaluation.per_frame` measures, of the bare body: the
displacement for clothes is no part of a pose. Under clothes not even the true pose reaches an IoU
of 1, so that its own value is the mark.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace

import torch
from torch import Tensor

from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.data.video import Video
from gva_mi.pose.evaluation.per_frame import Errors, errors, silhouette_iou
from gva_mi.pose.refine import Refined


@dataclass(frozen=True)
class PoseErrors:
    """Means over all frames, lengths in millimetres; None where it takes the truth."""

    vertex_mm_stage1: float | None
    vertex_mm: float | None
    hand_vertex_mm_stage1: float | None
    hand_vertex_mm: float | None
    foot_vertex_mm_stage1: float | None
    foot_vertex_mm: float | None
    aligned_vertex_mm_stage1: float | None
    aligned_vertex_mm: float | None
    frames_worse: float | None  # share of frames whose vertex error grew
    frames_worse_hands: float | None  # share of frames whose hand error grew
    iou_stage1: float
    iou: float
    iou_truth: float | None
    iou_true_masks: float | None  # of the refined pose with the masks of the truth
    seconds_per_frame: float

    def as_record(self) -> dict[str, float | None]:
        """For ``metrics.json``."""
        return asdict(self)


@dataclass(frozen=True)
class Measured:
    """A refinement, frame by frame."""

    stage1: Errors | None  # None without the truth
    refined: Errors | None
    iou_stage1: Tensor  # (T,)
    iou: Tensor  # (T,)
    iou_truth: Tensor | None  # (T,)
    iou_true_masks: Tensor | None  # (T,)
    seconds_per_frame: float

    @property
    def means(self) -> PoseErrors:
        """Over all frames."""
        names = {"vertex": "body", "hand_vertex": "hands", "foot_vertex": "feet"}
        names["aligned_vertex"] = "body_aligned"
        found = {"_stage1": self.stage1, "": self.refined}
        lengths = {
            f"{name}_mm{stage}": None if values is None else float(getattr(values, part).mean())
            for name, part in names.items()
            for stage, values in found.items()
        }
        grew = lambda part: float(
            (getattr(self.refined, part) > getattr(self.stage1, part)).float().mean()
        )
        known = self.refined is not None
        clean = self.iou_true_masks if known else torch.tensor(torch.nan)
        return PoseErrors(
            **lengths,
            frames_worse=grew("body") if known else None,
            frames_worse_hands=grew("hands") if known else None,
            iou_stage1=float(self.iou_stage1.nanmean()),
            iou=float(self.iou.nanmean()),
            iou_truth=float(self.iou_truth.nanmean()) if known else None,
            iou_true_masks=None if clean.isnan().all() else float(clean.nanmean()),
            seconds_per_frame=self.seconds_per_frame,
        )


def measure_frames(
    video: Video,
    body: BodyModel,
    refined: Refined,
    truth: tuple[Pose, Shape] | None = None,
    known: Measured | None = None,
) -> Measured:
    """Compare stage 1 and the refined poses with the masks, and with the truth where given.

    Args:
        video: the frames, under their stage-1 poses.
        body: the body.
        refined: what was found.
        truth: of a synthetic subject.
        known: another refinement of the same video: stage 1 and the truth need not be measured
            again.
    """
    before, after = (video.pose, video.shape), (refined.pose, refined.shape)
    if known is None:
        known = Measured(
            stage1=errors(body, before, truth) if truth is not None else None,
            refined=None,
            iou_stage1=silhouette_iou(video, body, *before),
            iou=torch.empty(0),
            iou_truth=silhouette_iou(video, body, *truth) if truth is not None else None,
            iou_true_masks=None,
            seconds_per_frame=0.0,
        )
    clean = silhouette_iou(video, body, *after, true_masks=True) if truth is not None else None
    return replace(
        known,
        refined=errors(body, after, truth) if truth is not None else None,
        iou=silhouette_iou(video, body, *after),
        iou_true_masks=clean,
        seconds_per_frame=refined.seconds_per_frame,
    )


def measure(
    video: Video, body: BodyModel, refined: Refined, truth: tuple[Pose, Shape] | None = None
) -> PoseErrors:
    """The same, in the mean."""
    return measure_frames(video, body, refined, truth).means
