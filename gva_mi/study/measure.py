"""Compare poses before and after refinement with the masks and with the ground truth.

Errors are those of :mod:`gva_mi.pose.errors`. The silhouette IoU compares the bare body with a
mask. Not even the ground-truth pose reaches an IoU of 1 under clothes: its IoU is the limit.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.core.threads import one_torch_thread
from gva_mi.data.ground_truth import Truth
from gva_mi.data.video import Video
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.pose.errors import pose_errors
from gva_mi.pose.job import RefineOptions
from gva_mi.pose.refine import Refined
from gva_mi.splat import Camera
from gva_mi.study.pose_figures import ERRORS, PoseFigures


@dataclass(frozen=True)
class Measured:
    """Figures of a refinement by the keys of :class:`PoseFigures`, each (T,), frame by frame.

    A figure that needs the ground truth is missing without it.
    """

    frames: Mapping[str, Tensor]
    seconds_per_frame: float = 0.0
    points: Literal["vertices", "joints"] | None = None

    @property
    def means(self) -> PoseFigures:
        """Means over the frames, without NaN."""
        means = {
            key: float(x.nanmean() if key.startswith("iou") else x.mean())
            for key, x in self.frames.items()
        }
        known = {key: mean for key, mean in means.items() if mean == mean or "masks" not in key}
        known |= {"points": self.points, "seconds_per_frame": self.seconds_per_frame}
        return PoseFigures.from_json(known)

    def of(self, frames: list[int]) -> Measured:
        """Return the figures of some of the frames."""
        return replace(self, frames={key: x[frames] for key, x in self.frames.items()})


@dataclass(frozen=True)
class Evaluation:
    """A refinement with its input and its figures."""

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
    """Compare stage 1 and the refined poses with the masks and, if given, the ground truth.

    Args:
        video: under its stage-1 poses.
        body: the fitted body.
        refined: the refined poses.
        truth: of a synthetic subject.
        known: figures of another refinement of the same video; saves measuring stage 1 again.
    """
    known = _measure_stage1(video, body, truth) if known is None else known
    after, cameras = (refined.pose, refined.shape), refined.cameras
    frames = {**known.frames, "iou": silhouette_iou(video, body, *after, cameras)}
    if truth is not None:
        frames |= {ERRORS[k]: x for k, x in pose_errors(body, after, truth).items()}
        for name, key in (("frames_worse", "vertex_mm"), ("frames_worse_hands", "hand_vertex_mm")):
            frames[name] = (frames[key] > frames[f"{key}_stage1"]).float()
        frames["iou_true_masks"] = silhouette_iou(video, body, *after, cameras, true_masks=True)
        frames["focal_error"] = _focal_errors(cameras or video.cameras, truth.cameras)
    return replace(known, frames=frames, seconds_per_frame=refined.seconds_per_frame)


def _measure_stage1(video: Video, body: BodyModel, truth: Truth | None) -> Measured:
    """Measure stage 1 and the ground truth."""
    before = (video.pose, video.shape)
    frames = {"iou_stage1": silhouette_iou(video, body, *before)}
    if truth is None:
        return Measured(frames)
    frames |= {f"{ERRORS[k]}_stage1": x for k, x in pose_errors(body, before, truth).items()}
    frames["iou_truth"] = silhouette_iou(video, truth.body, truth.pose, truth.shape, truth.cameras)
    frames["focal_error_stage1"] = _focal_errors(video.cameras, truth.cameras)
    return Measured(frames, points="joints" if truth.foreign else "vertices")


def _focal_errors(found: Sequence[Camera], true: Sequence[Camera]) -> Tensor:
    """Return relative errors (T,) of focal lengths; positive if too long."""
    lengths = [[(c.fx * c.fy) ** 0.5 for c in cameras] for cameras in (found, true)]
    return torch.from_numpy(np.divide(*lengths) - 1)


@torch.no_grad()
def silhouette_iou(
    video: Video,
    body: BodyModel,
    pose: Pose,
    shape: Shape,
    cameras: Sequence[Camera] | None = None,
    true_masks: bool = False,
) -> Tensor:
    """Return the IoU (T,) of the bare body's silhouette with the mask; NaN without a mask.

    Args:
        video: T frames.
        body, pose, shape: the body in T poses.
        cameras: of the poses; None: the video's.
        true_masks: compare with the ground-truth masks instead of the video's.
    """
    scene = MeshScene(body.faces, body.v_template)
    iou = torch.full((len(pose),), torch.nan)
    with one_torch_thread():
        for frame in video.outlines(k for k in range(len(video)) if k not in video.absent):
            mask = video.true_mask(frame.index) if true_masks else frame.mask
            if mask is None:
                continue
            mask = torch.from_numpy(mask)
            vertices = body(pose[frame.index], shape).vertices[0]
            camera = frame.camera if cameras is None else cameras[frame.index]
            seen = scene.render(vertices, camera)[..., 3]
            union = torch.maximum(seen, mask).sum()
            if union > 0:
                iou[frame.index] = torch.minimum(seen, mask).sum() / union
    return iou
