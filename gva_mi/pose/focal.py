"""One factor ``s`` on the focal length of a video, as an unknown of the descent.

A camera whose focal lengths are ``s`` times those of another shows the same picture as that one
shows of a world stretched across the line of sight. In camera space, with ``S = diag(s, s, 1)``:

1. ``x' = S x``: the picture of ``x'`` by the camera is that of ``x`` by the camera ``s fx, s fy``,
2. ``n' ∝ S^{-T} n``: normals of the stretched surface. Those that are rendered are brought back
   before they are compared, ``n = S n' / |S n'|``: were the frame's normals stretched instead, what
   differs would differ by more or less with ``s``, and count for as much more or less. The length
   takes no part in derivatives, for a renderer's hold at outlines for what is linear in its image;
   where ``s`` is near 1, little is missing,
3. ``z ← s z``: how large a person is seen goes by ``s / z``. So that a change of ``s`` leaves the
   size as it is, ``d log z = d log s``, the pelvis of every frame moves with it along the optical
   axis: the other coordinates of the descent keep what they have found, and ``s`` changes only how
   strongly near limbs grow and far ones shrink.

So ``s`` is differentiated through vertices, and the renderer knows nothing of it. Poses found by a
descent are those for ``s = 1`` until :func:`follow` moves them. It is looked for once poses are
nearly right, for limbs that are off by centimetres pass for another lens, too.

What ``s`` changes in a picture is small, a pixel where hands are before or behind the body, and
what is wrong with normals is not: blurred ones, or those of clothes, agree with a bare body better
the shorter the lens is, by more than its right length gains. So silhouettes alone tell ``s``, in
the poses and the shape that all evidence has found so far.

Even so it is weakly known, and found too long by some per cent where a person stays metres away.
Tried against that, in vain: to hold ``s`` until slopes of outlines agree over the parts of a video
(they do so for the right lens, too: clothes are no part of the body in every frame), and to move
``s`` to the least of a parabola between passes (each time poses have followed, outlines ask for as
much again).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.pose import Pose
from gva_mi.splat import Camera


def stretched(vertices: Tensor, cameras: Sequence[Camera], s: Tensor) -> Tensor:
    """Eq. 1, in the world's axes: differentiable in both.

    Args:
        vertices: (B, V, 3) world, metres.
        cameras: of the B frames, before the change.
        s: a scalar.
    """
    R, t = _world_to_camera(cameras, vertices.dtype)
    seen = vertices @ R.mT + t[:, None]
    return (torch.cat([s * seen[..., :2], seen[..., 2:]], -1) - t[:, None]) @ R


def brought_back(rendered: Tensor, s: Tensor) -> Tensor:
    """Eq. 2: rendered normals (..., 3) of the stretched surface as they were before, camera space.

    Differentiable, but for the length as said there. Zero, where there is no surface, stays zero.
    """
    shrunk = lambda n: torch.cat([s * n[..., :2], n[..., 2:]], -1)
    fixed = rendered.detach()
    lengths = fixed.norm(dim=-1, keepdim=True), shrunk(fixed).norm(dim=-1, keepdim=True)
    return shrunk(rendered) * (lengths[0] / lengths[1].clamp_min(1e-12))


def follow(pose: Pose, pelvis: Tensor, cameras: Sequence[Camera], s: Tensor | float) -> Pose:
    """Eq. 3: poses whose pelvis stands ``s`` times as deep; differentiable.

    Args:
        pose: T frames.
        pelvis: (3,) the pelvis at rest, metres.
        cameras: of the T frames.
        s: a scalar.
    """
    R, t = _world_to_camera(cameras, pose.transl.dtype)
    axis = R[:, 2]  # of the lens, in the world
    depth = ((pelvis + pose.transl) * axis).sum(1) + t[:, 2]
    moved = pose.transl + (s - 1) * depth[:, None] * axis
    return Pose(pose.rotations, moved, pose.expression)


def _world_to_camera(cameras: Sequence[Camera], dtype: torch.dtype) -> tuple[Tensor, Tensor]:
    T = torch.from_numpy(np.stack([camera.T_camera_world for camera in cameras])).to(dtype)
    return T[:, :3, :3], T[:, :3, 3]
