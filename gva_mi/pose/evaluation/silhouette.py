"""How well the bare body fills a mask.

The IoU compares the bare body's silhouette with the frame's mask, or with the true one. Not even
the true pose reaches an IoU of 1 under clothes, or with a mask whose outline is off by a pixel: the
IoU of the true pose says how much can be reached.
"""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.data.video import Video
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.splat import Camera
from gva_mi.threads import one_torch_thread


@torch.no_grad()
def silhouette_iou(
    video: Video,
    body: BodyModel,
    pose: Pose,
    shape: Shape,
    cameras: Sequence[Camera] | None = None,
    true_masks: bool = False,
) -> Tensor:
    """IoU (T,) of the bare body's silhouette with the mask; NaN where a frame has no mask.

    Args:
        video: the frames.
        body, pose, shape: the body in T poses.
        cameras: that the poses belong to, one a frame; None: the video's own.
        true_masks: compare with the masks of the truth, and not with those that came with the
            video.
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
