"""Linear blend skinning: of points (Eq. 4, 5) and of the frames of Gaussians (Eq. 6).

    1. T_world_rest[j] = G_j · translate(−J_j),    G_j = G_parent(j) · [R_j | J_j − J_parent(j)]
    2. A = Σ_j w_j T_world_rest[j]        one affine map per point; a row of weights sums to 1
    3. x' = A_rot x + A_trans                                                         (Eq. 5)
    4. q' = polar(A_rot) ⊗ q                                                          (Eq. 6)

Eq. 6 of the paper multiplies a Gaussian's rotation by A_rot as if it were one. It is a blend of
rotations, which shears and shrinks wherever its joints turn differently. Here means follow the
whole affine map, so that they stay on the skinned mesh, while orientations follow the rotation
nearest to A_rot, its polar factor: Gaussians keep their learned scales, and a rigid motion is
carried exactly. See :mod:`gva_mi.body.polar`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import roma
import torch
from torch import Tensor

from gva_mi.body.polar import carry_frames

_CHUNK = 1 << 24  # distances held at once by nearest_weights


def joint_transforms(
    rotations: Tensor, joints: Tensor, parents: Sequence[int], transl: Tensor
) -> Tensor:
    """Forward kinematics: the rigid map of each joint from the rest pose to the world (eq. 1).

    Joints of one depth in the tree are computed together, for all frames.

    Args:
        rotations: (T, J, 3) axis-angle relative to the parent, radians.
        joints: (J, 3) or (T, J, 3) positions in the rest pose, metres.
        parents: J indices, -1 for the root, which comes first.
        transl: (T, 3) added to everything, metres.

    Returns:
        T_world_rest, (T, J, 4, 4).
    """
    if rotations.ndim != 3 or rotations.shape[1:] != (len(parents), 3):
        raise ValueError(
            f"joint_transforms(): rotations must be (T, {len(parents)}, 3), "
            f"got {tuple(rotations.shape)}"
        )
    frames = rotations.shape[0]
    joints = joints.expand(frames, -1, -1)
    R = roma.rotvec_to_rotmat(rotations)
    parent_of = _parent_matrix(tuple(parents), joints.dtype)
    bones = joints - parent_of @ joints
    local = torch.cat([R, bones.unsqueeze(-1)], dim=-1)  # (T, J, 3, 4)

    levels, order = _levels(tuple(parents))
    above = local[:, levels[0]]
    world = [above]
    for level, previous in zip(levels[1:], levels[:-1], strict=True):
        # Zeros and ones pick the parents: unlike an index's, this gradient has one order of sums.
        pick = parent_of[level][:, previous]
        parent = (pick @ above.flatten(2)).unflatten(2, (3, 4))
        here = local[:, level]
        turned = parent[..., :3] @ here
        above = torch.cat([turned[..., :3], turned[..., 3:] + parent[..., 3:]], dim=-1)
        world.append(above)
    world = torch.cat(world, dim=1)[:, order]

    R_world = world[..., :3]
    t = world[..., 3] - (R_world @ joints.unsqueeze(-1)).squeeze(-1) + transl.unsqueeze(1)
    top = torch.cat([R_world, t.unsqueeze(-1)], dim=-1)
    bottom = top.new_tensor([0.0, 0.0, 0.0, 1.0]).expand(frames, len(parents), 1, 4)
    return torch.cat([top, bottom], dim=-2)


def skin_points(points: Tensor, weights: Tensor, T_world_rest: Tensor) -> Tensor:
    """Carry points of the rest pose into the world (eq. 2, 3), for one pose or for T of them.

    Args:
        points: (N, 3), or (T, N, 3) where they differ between the poses.
        weights: (N, J), rows sum to 1.
        T_world_rest: (J, 4, 4) or (T, J, 4, 4).

    Returns:
        (N, 3) or (T, N, 3).
    """
    # Coordinates come first and points last: all sums then run along memory, four times faster.
    A = (T_world_rest[..., :3, :].flatten(-2).mT @ weights.T).unflatten(-2, (3, 4))
    x, y, z = points.mT.unsqueeze(-3).unbind(-2)
    moved = A[..., 0, :] * x + A[..., 1, :] * y + A[..., 2, :] * z + A[..., 3, :]
    return moved.mT.contiguous()


def skin_gaussians(
    means: Tensor, quats: Tensor, weights: Tensor, T_world_rest: Tensor
) -> tuple[Tensor, Tensor]:
    """Carry Gaussians of the rest pose into the world (eq. 2-4).

    Args:
        means: (N, 3) metres, rest pose.
        quats: (N, 4) wxyz, of any length but zero, which is kept.
        weights: (N, J), rows sum to 1.
        T_world_rest: (J, 4, 4), its upper left 3x3 blocks rotations.

    Returns:
        means (N, 3) and quats (N, 4) in the world. Both are differentiable in all four arguments;
        the sign of a quaternion is arbitrary.
    """
    n = means.shape[0]
    for name, value, shape in (
        ("means", means, (n, 3)),
        ("quats", quats, (n, 4)),
        ("weights", weights, (n, T_world_rest.shape[0])),
        ("T_world_rest", T_world_rest, (T_world_rest.shape[0], 4, 4)),
    ):
        if tuple(value.shape) != shape:
            raise ValueError(f"skin_gaussians(): {name} must be {shape}, got {tuple(value.shape)}")
        if value.dtype != means.dtype:
            raise ValueError(
                f"skin_gaussians(): {name} is {value.dtype}, but means are {means.dtype}"
            )
    return carry_frames(blend(weights, T_world_rest), means, quats)


def blend(weights: Tensor, T_world_rest: Tensor) -> Tensor:
    """The blended affine map of each point, row by row (eq. 2), (..., N, 12)."""
    return weights @ T_world_rest[..., :3, :].flatten(-2)


def nearest_weights(points: Tensor, vertices: Tensor, weights: Tensor, joints: int = 4) -> Tensor:
    """Skinning weights of free points: those of the nearest vertex, its strongest joints only.

    Args:
        points: (N, 3) rest pose, metres.
        vertices: (V, 3) of the body in the same pose.
        weights: (V, J) of the body.
        joints: how many joints to keep; the kept weights are scaled to sum 1.

    Returns:
        (N, J).

    Note:
        Not differentiable: where the nearest vertex changes, the weights jump.
    """
    with torch.no_grad():
        rows = max(1, _CHUNK // len(vertices))
        exact = "donot_use_mm_for_euclid_dist"  # the product form is off by 0.3 mm in float32
        nearest = [
            torch.cdist(chunk, vertices, compute_mode=exact).argmin(1)
            for chunk in points.split(rows)
        ]
        return strongest(weights[torch.cat(nearest)], joints)


def strongest(weights: Tensor, joints: int = 4) -> Tensor:
    """Keep the largest weights of each row (N, J), scaled to sum 1; of equal ones the first."""
    order = torch.sort(weights, dim=1, descending=True, stable=True).indices[:, :joints]
    kept = torch.zeros_like(weights).scatter(1, order, weights.gather(1, order))
    return kept / kept.sum(1, keepdim=True)


@lru_cache(maxsize=8)
def _parent_matrix(parents: tuple[int, ...], dtype: torch.dtype) -> Tensor:
    """(J, J) with a one in row j, column parent(j); the root's row is zero."""
    matrix = torch.zeros(len(parents), len(parents), dtype=dtype)
    for joint, parent in enumerate(parents):
        if parent >= 0:
            matrix[joint, parent] = 1
    return matrix


@lru_cache(maxsize=8)
def _levels(parents: tuple[int, ...]) -> tuple[list[list[int]], list[int]]:
    """Joints grouped by their depth in the tree, and where each joint stands in that sequence."""
    if not parents or parents[0] != -1 or any(not 0 <= p < j for j, p in enumerate(parents) if j):
        raise ValueError("parents: the root (-1) must come first, every parent before its children")
    depth = [0] * len(parents)
    for joint, parent in enumerate(parents[1:], start=1):
        depth[joint] = depth[parent] + 1
    levels = [[j for j, d in enumerate(depth) if d == level] for level in range(max(depth) + 1)]
    flat = sum(levels, [])
    return levels, [flat.index(j) for j in range(len(parents))]
