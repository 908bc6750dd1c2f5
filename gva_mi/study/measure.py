"""Compare poses before and after refinement with the masks and with the ground truth.

Errors are those of :mod:`gva_mi.pose.errors`. The silhouette IoU compares the bare body with a
mask. Not even the ground-truth pose reaches an IoU of 1 under clothes: its IoU is the limit.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.core.cpu import one_thread
from gva_mi.data.crop import Box, NoEvidence, points_extent
from gva_mi.data.ground_truth import GroundTruth
from gva_mi.data.video import Video
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.pose.errors import pose_errors
from gva_mi.pose.observed_video import RefineOptions
from gva_mi.pose.refine import Refined
from gva_mi.splat import Camera

ALIGNED = ("body_aligned", "hands_aligned", "feet_aligned", "fingers")  # without the pelvis's place
ABSOLUTE = ("body", "hands", "feet")  # with the depth, which one camera hardly shows
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
    "pelvis_depth": "pelvis_depth_mm",
    "ankles_depth": "ankle_depth_mm",
    "wrists_depth": "wrist_depth_mm",
}
KEYS = (
    *(name for key in ERRORS.values() for name in (f"{key}_stage1", key)),
    "points", "frames_worse", "frames_worse_aligned", "frames_worse_hands", "iou_stage1", "iou",
    "iou_truth", "seconds_per_frame",
)  # fmt: skip


@dataclass(frozen=True)
class PoseFigures:
    """Figures by the keys of ``refinement.json``; a missing one is None.

    ``*_mm`` are errors of :mod:`gva_mi.pose.errors`, taken on ``points`` ("vertices" or "joints");
    ``frames_worse`` is the share of frames whose error increased, also pelvis-aligned and of the
    hands; ``iou`` compares the bare body with the masks, ``iou_truth`` the ground-truth body.
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
        for title, names in (("aligned", ALIGNED), ("absolute", ABSOLUTE)):
            if line := changes({name: self.change(name) for name in names}):
                yield f"{title:<11} {line}"
        depths = {limb: self.change(f"{limb}_depth") for limb in ("ankles", "wrists")}
        if all(depths.values()):
            texts = (f"{limb} {a:+.0f} → {b:+.0f} mm" for limb, (a, b) in depths.items())
            yield f"depth       {', '.join(texts)}"
        if self["frames_worse"] is not None:
            kinds = {"_aligned": "aligned", "": "absolute", "_hands": "of the hands"}
            known = {kind: self[f"frames_worse{name}"] for name, kind in kinds.items()}
            shares = (f"{kind} in {x:.0%}" for kind, x in known.items() if x is not None)
            yield f"increased   error: {', '.join(shares)} of the frames"
        iou, limit = self.change("iou"), self["iou_truth"]
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
            ValueError: a figure is not a number.
        """
        values = {key: record.get(key) for key in KEYS}
        for key, value in values.items():
            kind = str if key == "points" else int | float
            if value is not None and (isinstance(value, bool) or not isinstance(value, kind)):
                raise ValueError(f"'{key}' is {value!r:.40}")
        return PoseFigures(values)


def changes(both: Mapping[str, tuple[float, float] | None]) -> str:
    """Format errors before and after by the names of ERRORS, such as "hands 76.1 → 20.3", in mm."""
    known = (
        f"{name.removesuffix('_aligned')} {pair[0]:.1f} → {pair[1]:.1f}"
        for name, pair in both.items()
        if pair is not None
    )
    return f"{text} mm" if (text := ", ".join(known)) else ""


@dataclass(frozen=True)
class FrameFigures:
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
        about = {"points": self.points, "seconds_per_frame": self.seconds_per_frame}
        return PoseFigures.from_json(means | about)

    def of(self, frames: list[int]) -> FrameFigures:
        """Return the figures of some of the frames."""
        return replace(self, frames={key: x[frames] for key, x in self.frames.items()})


@dataclass(frozen=True)
class Evaluation:
    """A refinement with its input and its figures."""

    video: Video  # under its stage-1 poses
    body: BodyModel
    options: RefineOptions
    refined: Refined | None  # None: stage 1 alone is measured
    truth: GroundTruth | None = None  # of a synthetic subject
    truth_problem: str | None = None  # why a ground truth that is there cannot be used

    @cached_property
    def measured(self) -> FrameFigures:
        """Its figures."""
        return measure(self.video, self.body, self.refined, self.truth)


def measure(
    video: Video, body: BodyModel, refined: Refined | None, truth: GroundTruth | None = None
) -> FrameFigures:
    """Compare stage 1 and the refined poses with the masks and, if given, the ground truth.

    Args:
        video: under its stage-1 poses.
        body: the fitted body.
        refined: the refined poses; None: stage 1 alone is measured.
        truth: of a synthetic subject.
    """
    states = {"_stage1": (video.pose, video.shape, None)}
    if refined is not None:
        states[""] = refined.pose, refined.shape, refined.cameras
    seconds = 0.0 if refined is None else refined.seconds_per_frame
    frames = {f"iou{key}": silhouette_iou(video, body, *some) for key, some in states.items()}
    if truth is None:
        return FrameFigures(frames, seconds)
    for suffix, some in states.items():
        errors = pose_errors(body, some[:2], truth)
        frames |= {f"{ERRORS[k]}{suffix}": x for k, x in errors.items()}
    grown = {"": "vertex_mm", "_aligned": "aligned_vertex_mm", "_hands": "hand_vertex_mm"}
    for name, key in grown.items() if refined is not None else ():
        frames[f"frames_worse{name}"] = (frames[key] > frames[f"{key}_stage1"]).float()
    true = truth.pose, truth.shape, truth.cameras
    frames["iou_truth"] = silhouette_iou(video, truth.body, *true)
    return FrameFigures(frames, seconds, points="joints" if truth.foreign else "vertices")


def mask_iou(video: Video) -> float | None:
    """Return the mean IoU of a video's masks with the true ones; None if they are unknown."""
    found = []
    for frame in video.outlines(k for k in range(len(video)) if k not in video.absent):
        if (true := video.true_mask(frame.index)) is not None:
            both, either = (f(frame.mask, true).sum() for f in (np.minimum, np.maximum))
            found.append(float(both / either))
    return float(np.mean(found)) if found else None


@torch.no_grad()
def silhouette_iou(
    video: Video,
    body: BodyModel,
    pose: Pose,
    shape: Shape,
    cameras: Sequence[Camera] | None = None,
) -> Tensor:
    """Return the IoU (T,) of the bare body's silhouette with the mask; NaN without a mask.

    Args:
        video: T frames.
        body, pose, shape: the body in T poses.
        cameras: of the poses; None: the video's.
    """
    scene = MeshScene(body.faces, body.v_template)
    iou = torch.full((len(pose),), torch.nan)
    with one_thread():
        for frame in video.outlines(k for k in range(len(video)) if k not in video.absent):
            mask = torch.from_numpy(frame.mask)
            vertices = body(pose[frame.index], shape).vertices[0]
            camera = frame.camera if cameras is None else cameras[frame.index]
            box, seen = _surroundings(vertices, camera), torch.zeros_like(mask)
            part = scene.render(vertices, box.cut_camera(camera), normals=False)
            box.cut(seen)[:] = part[..., 0]
            union = torch.maximum(seen, mask).sum()
            if union > 0:
                iou[frame.index] = torch.minimum(seen, mask).sum() / union
    return iou


def _surroundings(vertices: Tensor, camera: Camera) -> Box:
    """Return the part of a camera's picture that shows vertices (V, 3), world; or all of it."""
    size = camera.width, camera.height
    try:
        extent = points_extent(vertices.double().numpy(), camera, "the body")
    except NoEvidence:
        return Box(0, 0, *size)
    return extent.box(0, np.array(size))
