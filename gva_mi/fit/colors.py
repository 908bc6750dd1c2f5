"""First colours of the body's surface, as the training frames show it.

    Σ_k w_vk (I_k(π_k(x_vk)) - c_v) = λ (Δ c)_v,     w_vk = S_k(π_k(x_vk)) · max(0, -n_vk · d_vk)²

where vertex v of the body, posed as in frame k, stands at x with normal n, d is the direction from
the camera to it, π the projection, I the picture, S the mask, and Δ the uniform Laplacian. Surfaces
seen from the front count fully, grazing ones hardly. If a limb hides a vertex in some frames, the
other frames outweigh them, and the fit corrects the rest. What no frame shows takes the colours
around it: the fit hardly changes it, and the person may turn round in a later motion.

From grey, Adam's steps of constant size would take hundreds of iterations to reach black or white.
"""

from __future__ import annotations

import torch
from torch import Tensor

from gva_mi.body.smplx import BodyModel
from gva_mi.data.video import Frame, Video
from gva_mi.mesh.surface import as_scipy, uniform_laplacian, vertex_normals

GREY = 0.5  # colour of the whole person if no frame shows it
SMOOTH = 0.01  # λ, frames
NEVER = 1e-6  # frames: far less than any that shows a vertex


@torch.no_grad()
def seen_colors(video: Video, body: BodyModel, offsets: Tensor | None = None) -> Tensor:
    """Return colours of the body's vertices, (V, 3), as the training frames show them.

    ``offsets`` (V, 3) displace the rest surface, metres.
    """
    from scipy.sparse import diags_array
    from scipy.sparse.linalg import splu

    total = torch.zeros(len(body.v_template), 3, dtype=torch.float64)
    weight = torch.zeros(len(body.v_template), 1, dtype=torch.float64)
    for frame in video.frames(video.splits.train):
        vertices = body(frame.pose, video.shape, offsets).vertices[0]
        color, seen = _frame_colors(frame, vertices, vertex_normals(vertices, body.faces))
        total += seen * color
        weight += seen
    # Every vertex tends a little to the mean of all, also one that is connected to none of these.
    mean = total.sum(0) / weight.sum() if weight.sum() > 0 else torch.full((3,), GREY)
    total, weight = total + NEVER * mean, weight[:, 0] + NEVER
    smooth = SMOOTH * as_scipy(uniform_laplacian(body.faces.numpy(), len(weight)))
    colors = splu((diags_array(weight.numpy()) + smooth).tocsc()).solve(total.numpy())
    return torch.from_numpy(colors).to(body.v_template)


def _frame_colors(frame: Frame, vertices: Tensor, normals: Tensor) -> tuple[Tensor, Tensor]:
    """Return one frame's colours (V, 3) of the vertices, and their weights (V, 1)."""
    camera, image = frame.camera, torch.from_numpy(frame.image)
    T = torch.tensor(camera.T_camera_world, dtype=vertices.dtype)
    x = vertices @ T[:3, :3].T + T[:3, 3]
    before = x[:, 2] > 1e-3
    z = x[:, 2].clamp_min(1e-3)
    column = (camera.fx * x[:, 0] / z + camera.cx).floor().long()
    row = (camera.fy * x[:, 1] / z + camera.cy).floor().long()
    inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height) & before
    column, row = column.clamp(0, camera.width - 1), row.clamp(0, camera.height - 1)
    toward = torch.nn.functional.normalize(x, dim=1)
    facing = -(normals @ T[:3, :3].T * toward).sum(1)
    mask = torch.from_numpy(frame.mask)[row, column]
    return image[row, column], (mask * inside * facing.clamp_min(0).square())[:, None]
