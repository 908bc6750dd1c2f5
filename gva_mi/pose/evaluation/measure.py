"""How well refined poses fit, by the masks and by the truth of a synthetic subject.

No step of the method reads these figures. Distances to the truth are those of
:mod:`gva_mi.pose.evaluation.errors`, agreement with masks that of
:mod:`gva_mi.pose.evaluation.silhouette`; here they are taken of stage 1 and of the refined poses,
frame by frame, and their means are :class:`gva_mi.pose.evaluation.figures.PoseFigures`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.smplx import BodyModel
from gva_mi.data.truth import Truth
from gva_mi.data.video import Video
from gva_mi.pose.evaluation.errors import PoseErrors, pose_errors
from gva_mi.pose.evaluation.figures import Change, PoseFigures
from gva_mi.pose.evaluation.silhouette import silhouette_iou
from gva_mi.pose.job import RefineOptions
from gva_mi.pose.refine import Refined
from gva_mi.splat import Camera

_NAMED = {"body": "vertices", "body_aligned": "aligned"}  # errors whose figure has another name


@dataclass(frozen=True)
class Measured:
    """The figures of a refinement, frame by frame."""

    stage1: PoseErrors | None  # None without the truth
    refined: PoseErrors | None
    iou_stage1: Tensor  # (T,)
    iou: Tensor  # (T,)
    iou_truth: Tensor | None  # (T,)
    iou_true_masks: Tensor | None  # (T,)
    seconds_per_frame: float
    focal_stage1: Tensor | None = None  # (T,) relative error of the focal length
    focal: Tensor | None = None  # (T,)
    foreign: bool = False  # the errors are those of joints

    @property
    def means(self) -> PoseFigures:
        """The means over all frames."""
        figures = PoseFigures(
            iou=Change(float(self.iou_stage1.nanmean()), float(self.iou.nanmean())),
            seconds_per_frame=self.seconds_per_frame,
        )
        if self.refined is None:
            return figures
        before, after = self.stage1.means(), self.refined.means()
        changes = {_NAMED.get(k, k): Change(before[k], after[k]) for k in after}
        clean = None if self.iou_true_masks is None else self.iou_true_masks.nanmean()
        focal = None
        if self.focal is not None:
            focal = Change(float(self.focal_stage1.mean()), float(self.focal.mean()))
        return replace(
            figures,
            **changes,
            points="joints" if self.foreign else "vertices",
            frames_worse=self._share_worse("body"),
            frames_worse_hands=self._share_worse("hands"),
            iou_truth=float(self.iou_truth.nanmean()),
            iou_true_masks=None if clean is None or clean.isnan() else float(clean),
            focal=focal,
        )

    def of(self, frames: list[int]) -> Measured:
        """The figures of some of the frames."""
        some = lambda x: None if x is None else x[frames]
        errors = lambda x: None if x is None else x.of(frames)
        return replace(
            self,
            stage1=errors(self.stage1),
            refined=errors(self.refined),
            iou_stage1=self.iou_stage1[frames],
            iou=self.iou[frames],
            iou_truth=some(self.iou_truth),
            iou_true_masks=some(self.iou_true_masks),
            focal_stage1=some(self.focal_stage1),
            focal=some(self.focal),
        )

    def _share_worse(self, region: str) -> float:
        grew = getattr(self.refined, region) > getattr(self.stage1, region)
        return float(grew.float().mean())


@dataclass(frozen=True)
class Evaluation:
    """A refinement with all it came from, and how well it fits."""

    video: Video  # under its stage-1 poses
    body: BodyModel
    options: RefineOptions
    refined: Refined
    truth: Truth | None  # of a synthetic subject
    measured: Measured

    @staticmethod
    def of(
        video: Video,
        body: BodyModel,
        options: RefineOptions,
        refined: Refined,
        truth: Truth | None = None,
    ) -> Evaluation:
        """Measure a refinement."""
        measured = measure(video, body, refined, truth)
        return Evaluation(video, body, options, refined, truth, measured)


def measure(
    video: Video,
    body: BodyModel,
    refined: Refined,
    truth: Truth | None = None,
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
    if known is None:
        known = _of_stage1(video, body, truth)
    after = (refined.pose, refined.shape)
    found = replace(
        known,
        iou=silhouette_iou(video, body, *after, refined.cameras),
        seconds_per_frame=refined.seconds_per_frame,
    )
    if truth is None:
        return found
    return replace(
        found,
        refined=pose_errors(body, after, truth),
        iou_true_masks=silhouette_iou(video, body, *after, refined.cameras, true_masks=True),
        focal=_focal_errors(refined.cameras or video.cameras, truth.cameras),
    )


def _of_stage1(video: Video, body: BodyModel, truth: Truth | None) -> Measured:
    """The figures of stage 1 and of the truth; those of the refined poses are still empty."""
    before = (video.pose, video.shape)
    figures = Measured(
        stage1=None,
        refined=None,
        iou_stage1=silhouette_iou(video, body, *before),
        iou=torch.empty(0),
        iou_truth=None,
        iou_true_masks=None,
        seconds_per_frame=0.0,
    )
    if truth is None:
        return figures
    true = (truth.body, truth.pose, truth.shape, truth.cameras)
    return replace(
        figures,
        stage1=pose_errors(body, before, truth),
        iou_truth=silhouette_iou(video, *true),
        focal_stage1=_focal_errors(video.cameras, truth.cameras),
        foreign=truth.foreign,
    )


def _focal_errors(found: Sequence[Camera], true: Sequence[Camera]) -> Tensor:
    """By how much a focal length is too long (T,), relative to the true one."""
    lengths = [[(c.fx * c.fy) ** 0.5 for c in cameras] for cameras in (found, true)]
    return torch.from_numpy(np.divide(*lengths) - 1)
