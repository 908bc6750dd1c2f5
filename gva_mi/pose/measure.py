"""How well poses fit, told by the truth of a synthetic subject; no step reads it.

Errors are distances between the vertices of the same body in the found and in the true pose, of the
bare body (the displacement for clothes is no part of a pose). *Root-aligned* ones compare after the
pelvis joints are laid on each other, which leaves out the depth that one camera hardly sees. The
silhouette's IoU is that of the bare body against the frame's mask: under clothes even the true pose
does not reach 1, so that its own value is the mark.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import torch
from torch import Tensor

from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.data.video import Video
from gva_mi.pose.displacement import hand_vertices
from gva_mi.pose.refine import Refined
from gva_mi.pose.scene import BodyScene

_FEET = [
    JOINTS.index(f"{side}_{joint}") for side in ("left", "right") for joint in ("ankle", "foot")
]


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
    iou_stage1: float
    iou: float
    iou_truth: float | None
    seconds_per_frame: float

    def as_record(self) -> dict[str, float | None]:
        """For ``metrics.json``."""
        return asdict(self)


@torch.no_grad()
def measure(
    video: Video, body: BodyModel, refined: Refined, truth: tuple[Pose, Shape] | None = None
) -> PoseErrors:
    """Compare stage 1 and the refined poses with the masks, and with the truth where given."""
    found = {"stage1": (video.pose, video.shape), "refined": (refined.pose, refined.shape)}
    if truth is not None:
        found["truth"] = truth
    scene = BodyScene(body.faces, body.v_template)
    iou = {name: [] for name in found}
    errors: dict[str, list[Tensor]] = {"stage1": [], "refined": []}
    parts = torch.stack(
        [torch.ones(len(body.weights)), hand_vertices(body.weights), body.weights[:, _FEET].sum(1) >
        0.5]
    )  # fmt: skip
    for frame in video.frames():
        mask = torch.from_numpy(frame.mask)
        posed = {name: body(pose[frame.index], shape) for name, (pose, shape) in found.items()}
        for name, one in posed.items():
            seen = scene.render(one.vertices[0], frame.camera)[..., 3]
            union = torch.maximum(seen, mask).sum()
            iou[name].append(float(torch.minimum(seen, mask).sum() / union) if union > 0 else 0.0)
        for name in errors if truth is not None else ():
            difference = posed[name].vertices[0] - posed["truth"].vertices[0]
            root = posed[name].joints[0, 0] - posed["truth"].joints[0, 0]
            far = difference.norm(dim=1)
            by_part = parts @ far / parts.sum(1)
            errors[name].append(torch.stack([*by_part, (difference - root).norm(dim=1).mean()]))
    mean = lambda values: sum(values) / len(values)
    body_mm = hand_mm = foot_mm = aligned_mm = {"stage1": None, "refined": None}
    worse = None
    if truth is not None:
        tables = {name: 1e3 * torch.stack(rows) for name, rows in errors.items()}
        column = lambda k: {name: float(table[:, k].mean()) for name, table in tables.items()}
        body_mm, hand_mm, foot_mm, aligned_mm = (column(k) for k in range(4))
        worse = float((tables["refined"][:, 0] > tables["stage1"][:, 0]).float().mean())
    return PoseErrors(
        vertex_mm_stage1=body_mm["stage1"],
        vertex_mm=body_mm["refined"],
        hand_vertex_mm_stage1=hand_mm["stage1"],
        hand_vertex_mm=hand_mm["refined"],
        foot_vertex_mm_stage1=foot_mm["stage1"],
        foot_vertex_mm=foot_mm["refined"],
        aligned_vertex_mm_stage1=aligned_mm["stage1"],
        aligned_vertex_mm=aligned_mm["refined"],
        frames_worse=worse,
        iou_stage1=mean(iou["stage1"]),
        iou=mean(iou["refined"]),
        iou_truth=mean(iou["truth"]) if truth is not None else None,
        seconds_per_frame=refined.seconds_per_frame,
    )
