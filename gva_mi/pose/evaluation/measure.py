"""How well poses fit, by the masks and by the truth of a synthetic subject.

No step of the method reads these figures.

Errors are mean distances between the vertices of one body in two poses. *Root-aligned* ones compare
after the pelvis joints are laid on each other, which leaves out the depth that one camera hardly
sees:

    e_region = mean_v |x_v - y_v|,        a_region = mean_v |(x_v - x_pelvis) - (y_v - y_pelvis)|

over the vertices ``v`` of the whole body, the hands or the feet. All is measured on the bare body:
the displacement for clothes is no part of a pose.

The silhouette's IoU compares the bare body with the frame's mask, or with the true one. Not even
the true pose reaches an IoU of 1 under clothes, or with a mask whose outline is off by a pixel: the
IoU of the true pose says how much can be reached.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial

import torch
from torch import Tensor

from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.data.video import Video
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.pose.displacement import hand_vertices
from gva_mi.pose.job import RefineOptions
from gva_mi.pose.refine import Refined
from gva_mi.threads import one_torch_thread

_FEET = [
    JOINTS.index(f"{side}_{joint}") for side in ("left", "right") for joint in ("ankle", "foot")
]


@dataclass(frozen=True)
class VertexErrors:
    """Mean distances of vertices by region of the body, in T frames; each (T,), millimetres."""

    body: Tensor
    hands: Tensor
    feet: Tensor
    body_aligned: Tensor
    hands_aligned: Tensor
    feet_aligned: Tensor


REGIONS = tuple(field.name for field in fields(VertexErrors))


@dataclass(frozen=True)
class Change:
    """A figure of stage 1, and the same of the refined poses."""

    stage1: float
    refined: float


@dataclass(frozen=True)
class PoseFigures:
    """Means over all frames; None where a figure needs the truth and there is none."""

    vertices: Change | None  # mm
    hands: Change | None  # mm
    feet: Change | None  # mm
    aligned: Change | None  # of all vertices, root-aligned, mm
    frames_worse: float | None  # share of frames whose vertex error grew
    frames_worse_hands: float | None  # share of frames whose hand error grew
    iou: Change | None  # None where no refinement was measured
    iou_truth: float | None  # of the true pose
    iou_true_masks: float | None  # of the refined pose with the masks of the truth
    seconds_per_frame: float | None

    def lines(self) -> Iterator[str]:
        """The main figures, a line each; those that take the truth where it is known.

        "Aligned" are the vertices after the pelvis was laid on the true one.
        """
        for name, change in (
            ("vertices", self.vertices),
            ("hands", self.hands),
            ("feet", self.feet),
            ("aligned", self.aligned),
        ):
            if change is not None:
                yield f"{name:<11} {change.stage1:.1f} → {change.refined:.1f} mm"
        if self.frames_worse is not None:
            worse = f"{self.frames_worse:.0%} of the frames"
            yield f"worse       {worse}, in the hands {self.frames_worse_hands:.0%}"
        if self.iou is not None:
            truth = self.iou_truth
            own = f" (true pose {truth:.3f})" if truth is not None else ""
            yield f"silhouette  IoU {self.iou.stage1:.3f} → {self.iou.refined:.3f}{own}"

    def to_json(self) -> dict[str, float | None]:
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
    def from_json(record: Mapping[str, float | None]) -> PoseFigures:
        """What :meth:`to_json` wrote; figures that are missing are None."""
        figures = {}
        for field in fields(PoseFigures):
            if field.name in _CHANGES:
                key = _CHANGES[field.name]
                both = record.get(f"{key}_stage1"), record.get(key)
                figures[field.name] = None if None in both else Change(*both)
            else:
                figures[field.name] = record.get(field.name)
        return PoseFigures(**figures)


_CHANGES = {  # the key of the refined figure in JSON; that of stage 1 has "_stage1" after it
    "vertices": "vertex_mm",
    "hands": "hand_vertex_mm",
    "feet": "foot_vertex_mm",
    "aligned": "aligned_vertex_mm",
    "iou": "iou",
}


@dataclass(frozen=True)
class Measured:
    """The figures of a refinement, frame by frame."""

    stage1: VertexErrors | None  # None without the truth
    refined: VertexErrors | None
    iou_stage1: Tensor  # (T,)
    iou: Tensor  # (T,)
    iou_truth: Tensor | None  # (T,)
    iou_true_masks: Tensor | None  # (T,)
    seconds_per_frame: float

    @property
    def means(self) -> PoseFigures:
        """The means over all frames."""
        known = self.refined is not None
        clean = None if self.iou_true_masks is None else float(self.iou_true_masks.nanmean())
        return PoseFigures(
            vertices=self._change("body"),
            hands=self._change("hands"),
            feet=self._change("feet"),
            aligned=self._change("body_aligned"),
            frames_worse=self._share_worse("body"),
            frames_worse_hands=self._share_worse("hands"),
            iou=Change(float(self.iou_stage1.nanmean()), float(self.iou.nanmean())),
            iou_truth=float(self.iou_truth.nanmean()) if known else None,
            iou_true_masks=None if clean is None or math.isnan(clean) else clean,
            seconds_per_frame=self.seconds_per_frame,
        )

    def _change(self, region: str) -> Change | None:
        if self.refined is None:
            return None
        return Change(*(float(getattr(e, region).mean()) for e in (self.stage1, self.refined)))

    def _share_worse(self, region: str) -> float | None:
        if self.refined is None:
            return None
        grew = getattr(self.refined, region) > getattr(self.stage1, region)
        return float(grew.float().mean())


@dataclass(frozen=True)
class Evaluation:
    """A refinement with all it came from, and how well it fits."""

    video: Video  # under its stage-1 poses
    body: BodyModel
    options: RefineOptions
    refined: Refined
    truth: tuple[Pose, Shape] | None  # of a synthetic subject
    measured: Measured

    @staticmethod
    def of(
        video: Video,
        body: BodyModel,
        options: RefineOptions,
        refined: Refined,
        truth: tuple[Pose, Shape] | None = None,
    ) -> Evaluation:
        """Measure a refinement."""
        measured = measure(video, body, refined, truth)
        return Evaluation(video, body, options, refined, truth, measured)


def measure(
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
            stage1=vertex_errors(body, before, truth) if truth is not None else None,
            refined=None,
            iou_stage1=silhouette_iou(video, body, *before),
            iou=torch.empty(0),
            iou_truth=silhouette_iou(video, body, *truth) if truth is not None else None,
            iou_true_masks=None,
            seconds_per_frame=0.0,
        )
    iou = partial(silhouette_iou, video, body, *after, focal=refined.focal)
    return replace(
        known,
        refined=vertex_errors(body, after, truth) if truth is not None else None,
        iou=iou(),
        iou_true_masks=iou(true_masks=True) if truth is not None else None,
        seconds_per_frame=refined.seconds_per_frame,
    )


@torch.no_grad()
def vertex_errors(
    body: BodyModel, found: tuple[Pose, Shape], truth: tuple[Pose, Shape], batch: int = 16
) -> VertexErrors:
    """Errors of found poses against the true ones, ``batch`` frames at a time."""
    regions = torch.stack(
        [
            torch.ones(len(body.weights)),
            hand_vertices(body.weights).float(),
            (body.weights[:, _FEET].sum(1) > 0.5).float(),
        ]
    )
    regions = regions / regions.sum(1, keepdim=True)
    distances = []
    with one_torch_thread():
        for start in range(0, len(truth[0]), batch):
            some = slice(start, start + batch)
            x, y = (body(pose[some], shape) for pose, shape in (found, truth))
            apart = x.vertices - y.vertices
            aligned = apart - (x.joints[:, :1] - y.joints[:, :1])
            distances.append(
                torch.cat([apart.norm(dim=2), aligned.norm(dim=2)], 1).unflatten(1, (2, -1))
            )
    table = 1e3 * torch.cat(distances) @ regions.T  # (T, 2, 3): free and aligned, by region
    return VertexErrors(**dict(zip(REGIONS, table.flatten(1).T, strict=True)))


@torch.no_grad()
def silhouette_iou(
    video: Video,
    body: BodyModel,
    pose: Pose,
    shape: Shape,
    true_masks: bool = False,
    focal: float = 1.0,
) -> Tensor:
    """IoU (T,) of the bare body's silhouette with the mask; NaN where a frame has no mask.

    Args:
        video: the frames.
        body, pose, shape: the body in T poses.
        true_masks: compare with the masks of the truth, and not with those that came with the
            video.
        focal: factor on the focal lengths of the video, which the poses belong to.
    """
    scene = MeshScene(body.faces, body.v_template)
    iou = torch.full((len(pose),), torch.nan)
    with one_torch_thread():
        for frame in video.frames(k for k in range(len(video)) if k not in video.absent):
            mask = video.true_mask(frame.index) if true_masks else frame.mask
            if mask is None:
                continue
            mask = torch.from_numpy(mask)
            vertices = body(pose[frame.index], shape).vertices[0]
            seen = scene.render(vertices, frame.camera.zoomed(focal))[..., 3]
            union = torch.maximum(seen, mask).sum()
            if union > 0:
                iou[frame.index] = torch.minimum(seen, mask).sum() / union
    return iou
