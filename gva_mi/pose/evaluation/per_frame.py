"""How far poses are from the truth and from the masks, frame by frame.

Errors are mean distances between the vertices of one body in two poses. *Root-aligned* ones compare
after the pelvis joints are laid on each other, which leaves out the depth that one camera hardly
sees:

    e_part = mean_v |x_v - y_v|,        a_part = mean_v |(x_v - x_pelvis) - (y_v - y_pelvis)|

over the vertices ``v`` of the whole body, the hands or the feet. The silhouette's IoU is that of
the bare body against the frame's mask, or against the true one: a mask whose outline is off by a
pixel has no IoU of 1 even with the true body.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.data.video import Video
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.pose.displacement import hand_vertices
from gva_mi.threads import one_torch_thread

_FEET = [
    JOINTS.index(f"{side}_{joint}") for side in ("left", "right") for joint in ("ankle", "foot")
]


@dataclass(frozen=True)
class Errors:
    """Of T frames, each (T,), millimetres."""

    body: Tensor
    hands: Tensor
    feet: Tensor
    body_aligned: Tensor
    hands_aligned: Tensor
    feet_aligned: Tensor


@torch.no_grad()
def errors(
    body: BodyModel, found: tuple[Pose, Shape], truth: tuple[Pose, Shape], batch: int = 16
) -> Errors:
    """Of found poses against the true ones, ``batch`` frames at a time."""
    parts = torch.stack(
        [
            torch.ones(len(body.weights)),
            hand_vertices(body.weights).float(),
            (body.weights[:, _FEET].sum(1) > 0.5).float(),
        ]
    )
    parts = parts / parts.sum(1, keepdim=True)
    rows = []
    with one_torch_thread():
        for start in range(0, len(truth[0]), batch):
            some = slice(start, start + batch)
            x, y = (body(pose[some], shape) for pose, shape in (found, truth))
            apart = x.vertices - y.vertices
            aligned = apart - (x.joints[:, :1] - y.joints[:, :1])
            rows.append(
                torch.cat([apart.norm(dim=2), aligned.norm(dim=2)], 1).unflatten(1, (2, -1))
            )
    table = 1e3 * torch.cat(rows) @ parts.T  # (T, 2, 3)
    return Errors(*table.flatten(1).T)


@torch.no_grad()
def silhouette_iou(
    video: Video, body: BodyModel, pose: Pose, shape: Shape, true_masks: bool = False
) -> Tensor:
    """Of the bare body with the masks, (T,); NaN where a frame has none.

    Args:
        video: the frames.
        body, pose, shape: the body in T poses.
        true_masks: against those of the truth, and not those that came with the video.
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
            seen = scene.render(vertices, frame.camera)[..., 3]
            union = torch.maximum(seen, mask).sum()
            if union > 0:
                iou[frame.index] = torch.minimum(seen, mask).sum() / union
    return iou
