"""A factor ``s`` on the focal length, as an unknown of the optimisation.

A camera with ``s`` times the focal lengths shows the same image as the original one shows of a
world stretched across the line of sight. In camera space, with ``S = diag(s, s, 1)``:

1. ``x' = S x``: the image of ``x'`` by the camera is that of ``x`` by the camera ``s fx, s fy``.
2. ``n' ∝ S^{-T} n``: normals of the stretched surface. Rendered ones are brought back before they
   are compared, ``n = S n' / |S n'|``; stretching the frame's normals instead would scale all
   differences with ``s``. The length is not differentiated, because a renderer's derivatives at
   outlines hold for what is linear in its image; the error is small where ``s`` is near 1.
3. ``z ← s z``: the pelvis of every frame moves along the optical axis, so that ``s`` leaves the
   person's size in the image as it is, and changes only the perspective of near and far limbs.

So ``s`` is differentiated through vertices, and the renderer needs no change. Poses are those for
``s = 1`` until :func:`follow` moves them. ``s`` is refined once poses are nearly right, from
silhouettes alone: wrong normals, blurred or those of clothes, bias it more than it changes them.

It remains weakly determined, and some per cent too long if a person stays metres away.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.pose import Pose
from gva_mi.splat import Camera


def stretched(vertices: Tensor, cameras: Sequence[Camera], s: Tensor) -> Tensor:
    """Return eq. 1 of vertices (B, V, 3), world, metres, seen by B cameras; differentiable."""
    R, t = _world_to_camera(cameras, vertices.dtype)
    seen = vertices @ R.mT + t[:, None]
    return (torch.cat([s * seen[..., :2], seen[..., 2:]], -1) - t[:, None]) @ R


def brought_back(rendered: Tensor, s: Tensor) -> Tensor:
    """Return eq. 2 of rendered normals (..., 3) of the stretched surface, camera space.

    Differentiable but for the length. Background, zero, stays zero.
    """
    shrunk = lambda n: torch.cat([s * n[..., :2], n[..., 2:]], -1)
    fixed = rendered.detach()
    lengths = fixed.norm(dim=-1, keepdim=True), shrunk(fixed).norm(dim=-1, keepdim=True)
    return shrunk(rendered) * (lengths[0] / lengths[1].clamp_min(1e-12))


def follow(pose: Pose, pelvis: Tensor, cameras: Sequence[Camera], s: Tensor | float) -> Pose:
    """Return eq. 3: T poses whose pelvis, at rest at (3,), is ``s`` times as deep."""
    R, t = _world_to_camera(cameras, pose.transl.dtype)
    axis = R[:, 2]  # optical axis, in the world
    depth = ((pelvis + pose.transl) * axis).sum(1) + t[:, 2]
    moved = pose.transl + (s - 1) * depth[:, None] * axis
    return Pose(pose.rotations, moved, pose.expression)


def _world_to_camera(cameras: Sequence[Camera], dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    T = torch.from_numpy(np.stack([camera.T_camera_world for camera in cameras])).to(dtype)
    return T[:, :3, :3], T[:, :3, 3]
