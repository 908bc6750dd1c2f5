"""Forward kinematics: from joint rotations to rigid transforms, with adjoint and tangent.

    1. R_j = I + a [r_j]× + b [r_j]×²,    a = sin θ / θ,  b = (1 − cos θ) / θ²,  θ = |r_j|
    2. T_j = T_parent(j) · [R_j | J_j − R_j J_j]        joint j turns what hangs on it about itself

==========  ======================  ===============  ============================================
Symbol      Name                    Shape            Unit
==========  ======================  ===============  ============================================
r           ``rotations``           (T, J, 3)        radians, axis-angle relative to the parent
J           ``joints``              (T or 1, J, 3)   metres, rest pose
T = [A|t]   ``T_world_rest``        (T, J, 4, 4)     metres
==========  ======================  ===============  ============================================

The adjoint is statics. A gradient of t_d is a force f_d at t_d, a gradient of A_d a couple; a small
rotation ω of joint j moves all d on j, and the loss changes by ω · torque about p_j, the joint's
place in the world:

    3. F_j = Σ_{d on j} f_d,    M_j = Σ_{d on j} t_d × f_d + vee(grad_A_d A_dᵀ)
    4. grad_r_j = (I + b [r_j]× + c [r_j]×²)ᵀ [A_parentᵀ (M_j − p_j × F_j) + vee(grad_R_j R_jᵀ)]
    5. grad_J_j = (A_parent − A_j)ᵀ F_j,    grad_transl = F_root

with c = (1 − a) / θ², vee(X) · ω = ⟨X, [ω]×⟩, and "d on j" for j and all its descendants. Neither
direction walks along the tree: sums over subtrees are one product with a matrix of ones, products
along ancestors double their length at every step.

The tangent is the motion that these forces do work on. Joint j rotates all d on j by Ω_j:

    6. Ω_j = A_parent (I + b [r_j]× + c [r_j]×²) dr_j,    m_j = p_j × Ω_j + (A_parent − A_j) dJ_j
    7. dA_d = [Σ_{j: d on j} Ω_j]× A_d,    dt_d = Σ_{j: d on j} (Ω_j × t_d + m_j) + dtransl

Sources: eq. 1 is Rodrigues' formula; eq. 2 is eq. 3 and 4 of SMPL (Loper et al., 2015). Eq. 3-7 are
derived here, by the principle of virtual work.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx

from gva_mi.core.cpu import sqrt


def joint_transforms(
    rotations: Tensor, joints: Tensor, parents: Sequence[int], transl: Tensor
) -> Tensor:
    """Return the rigid transform of each joint from the rest pose to the world (eq. 2).

    Args:
        rotations: (T, J, 3) axis-angle relative to the parent, radians.
        joints: (J, 3) or (T, J, 3) positions in the rest pose, metres.
        parents: J indices, -1 for the root, which comes first.
        transl: (T, 3) added to everything, metres.

    Returns:
        T_world_rest, (T, J, 4, 4), differentiable once in all but the tree.

    Raises:
        ValueError: a wrong shape of ``rotations``, or a child before its parent.

    Example:
        A chain of two joints one metre apart: the first turns by 90° about z and takes the second
        along, from x = 1 to y = 1.

        >>> rotations = torch.tensor([[[0, 0, torch.pi / 2], [0, 0, 0]]])
        >>> joints = torch.tensor([[0.0, 0, 0], [1, 0, 0]])
        >>> T = joint_transforms(rotations, joints, (-1, 0), torch.zeros(1, 3))
        >>> joint_places(T[0], joints).round(decimals=4) + 0
        tensor([[0., 0., 0.],
                [0., 1., 0.]])
    """
    if rotations.ndim != 3 or rotations.shape[1:] != (len(parents), 3):
        raise ValueError(
            f"joint_transforms(): rotations must be (T, {len(parents)}, 3), "
            f"got {tuple(rotations.shape)}"
        )
    return turn_joints(rotations, joints, parents, transl)[1]


def joint_places(T_world_rest: Tensor, joints: Tensor) -> Tensor:
    """Return joints (..., J, 3) in the world, from their transforms and rest positions (J, 3).

    Example:
        >>> T = torch.eye(4).repeat(2, 1, 1)
        >>> T[:, 1, 3] = 0.5  # everything half a metre up
        >>> joint_places(T, torch.tensor([[0.0, 0, 0], [1, 0, 0]]))
        tensor([[0.0000, 0.5000, 0.0000],
                [1.0000, 0.5000, 0.0000]])
    """
    A, t = T_world_rest[..., :3, :3], T_world_rest[..., :3, 3]
    return (A @ joints.unsqueeze(-1)).squeeze(-1) + t


def turn_joints(
    rotations: Tensor, joints: Tensor, parents: Sequence[int], transl: Tensor
) -> tuple[Tensor, Tensor]:
    """Return rotation matrices R (T, J, 3, 3), and the result of :func:`joint_transforms`.

    Example:
        >>> joints = torch.tensor([[0.0, 0, 0], [1, 0, 0]])
        >>> R, T = turn_joints(torch.zeros(5, 2, 3), joints, (-1, 0), torch.zeros(5, 3))
        >>> R.shape, T.shape
        (torch.Size([5, 2, 3, 3]), torch.Size([5, 2, 4, 4]))
    """
    joints = joints if joints.ndim == 3 else joints.unsqueeze(0)
    return _TurnJoints.apply(rotations, joints, transl, _tree(tuple(parents), rotations.dtype))


class _TurnJoints(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: FunctionCtx, rotations: Tensor, joints: Tensor, transl: Tensor, tree: _Tree
    ) -> tuple[Tensor, Tensor]:
        frames, count = rotations.shape[:2]
        R, a, b, square = _rodrigues(rotations, tree)

        maps = torch.zeros(frames, count + 1, 4, 4, dtype=R.dtype)  # the last: above the root
        maps[:, :count, :3, :3] = R
        maps[:, :count, :3, 3] = joints - (R @ joints.unsqueeze(-1)).squeeze(-1)
        maps[:, count, :3, :3] = tree.identity
        maps[:, :, 3, 3] = 1
        for ancestors in tree.doubling:
            maps = maps.index_select(1, ancestors) @ maps
        T_world_rest = maps[:, :count].clone()
        T_world_rest[..., :3, 3] += transl.unsqueeze(1)

        saved = rotations, joints, R, maps, a, b, square
        ctx.save_for_backward(*saved)
        ctx.save_for_forward(*saved)
        ctx.tree = tree
        return R, T_world_rest

    @staticmethod
    def jvp(
        ctx: FunctionCtx, drotations: Tensor, djoints: Tensor, dtransl: Tensor, _: None
    ) -> tuple[Tensor, Tensor]:
        rotations, joints, R, maps, a, b, square = ctx.saved_tensors
        tree: _Tree = ctx.tree
        A, t, A_parent, places = _in_world(maps, joints, tree)
        turned = lambda A, x: (A @ x.unsqueeze(-1)).squeeze(-1)

        across = torch.linalg.cross(rotations, drotations)  # eq. 6
        turn = drotations + b * across + _c(a, square) * torch.linalg.cross(rotations, across)
        spin = turned(A_parent, turn)
        shift = torch.linalg.cross(places, spin) + turned(A_parent - A, djoints)

        spin, shift = tree.hangs_on.T @ spin, tree.hangs_on.T @ shift  # eq. 7
        dT_world_rest = torch.zeros_like(maps[:, :-1])
        dT_world_rest[..., :3, :3] = _cross_matrix(spin, tree) @ A
        moved = torch.linalg.cross(spin, t) + shift
        dT_world_rest[..., :3, 3] = moved + dtransl.unsqueeze(1)
        return _cross_matrix(turn, tree) @ R, dT_world_rest

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(
        ctx: FunctionCtx, grad_R: Tensor, grad_T: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, None]:
        rotations, joints, R, maps, a, b, square = ctx.saved_tensors
        tree: _Tree = ctx.tree
        A, t, A_parent, places = _in_world(maps, joints, tree)

        force, grad_A = grad_T[..., :3, 3], grad_T[..., :3, :3]  # eq. 3
        moment = torch.linalg.cross(t, force) + _vee(grad_A @ A.mT)
        wrench = torch.cat([force, moment], dim=-1).unsqueeze(1)
        # A matrix product would start a second thread, which takes longer than the sums.
        force, moment = (tree.hangs_on.unsqueeze(-1) * wrench).sum(2).split(3, dim=-1)

        torque = moment - torch.linalg.cross(places, force)  # eq. 4
        torque = _turned_back(A_parent, torque) + _vee(grad_R @ R.mT)
        across = torch.linalg.cross(rotations, torque)
        again = torch.linalg.cross(rotations, across)
        grad_rotations = torque - b * across + _c(a, square) * again

        grad_joints = _turned_back(A_parent - A, force)  # eq. 5
        if len(joints) < len(rotations):
            grad_joints = grad_joints.sum(0, keepdim=True)
        return grad_rotations, grad_joints, force[:, 0], None


def _rodrigues(rotations: Tensor, tree: _Tree) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return R of eq. 1, and a, b, θ² (T, J, 1). Sinc has no pole at 0."""
    square = (rotations * rotations).sum(-1, keepdim=True)
    angle = sqrt(square) / math.pi
    a, b = torch.sinc(angle), torch.sinc(angle / 2).square() / 2
    skew = _cross_matrix(rotations, tree)
    outer = rotations.unsqueeze(-1) * rotations.unsqueeze(-2)  # [r]×² + θ² I
    one = (1 - b * square).unsqueeze(-1) * tree.identity
    return a.unsqueeze(-1) * skew + b.unsqueeze(-1) * outer + one, a, b, square


def _c(a: Tensor, square: Tensor) -> Tensor:
    """Return c of eq. 4 and 6, from a and θ²."""
    return torch.where(square > 0, (1 - a) / square, 1 / 6)


def _cross_matrix(x: Tensor, tree: _Tree) -> Tensor:
    """Return [x]×, (..., 3, 3), of vectors (..., 3)."""
    return (x @ tree.cross).unflatten(-1, (3, 3))


def _vee(X: Tensor) -> Tensor:
    """Return the vector (..., 3) with vee(X) · ω = ⟨X, [ω]×⟩ for all ω, from X (..., 3, 3)."""
    entries = X.flatten(-2)
    return entries[..., [7, 2, 3]] - entries[..., [5, 6, 1]]


def _in_world(maps: Tensor, joints: Tensor, tree: _Tree) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """Return A, t and A_parent of each joint, and the joints' places p, all without transl."""
    above = maps.index_select(1, tree.parents)
    A_parent = above[..., :3, :3]
    places = (A_parent @ joints.unsqueeze(-1)).squeeze(-1) + above[..., :3, 3]
    return maps[:, :-1, :3, :3], maps[:, :-1, :3, 3], A_parent, places


def _turned_back(A: Tensor, x: Tensor) -> Tensor:
    """Return Aᵀ x for A (..., 3, 3) and x (..., 3)."""
    return (x.unsqueeze(-2) @ A).squeeze(-2)


@dataclass(frozen=True)
class _Tree:
    """Constants of a tree of J joints that depend on no pose. Index J is above the root."""

    parents: Tensor  # (J,)
    doubling: tuple[Tensor, ...]  # (J + 1,) the 1st, 2nd, 4th ... ancestor of each
    hangs_on: Tensor  # (J, J) one in row j, column d where d is j or its descendant
    cross: Tensor  # (3, 9) takes ω to the rows of [ω]×
    identity: Tensor  # (3, 3)


@lru_cache(maxsize=8)
def _tree(parents: tuple[int, ...], dtype: torch.dtype) -> _Tree:
    if not parents or parents[0] != -1 or any(not 0 <= p < j for j, p in enumerate(parents) if j):
        raise ValueError("parents: the root (-1) must come first, every parent before its children")
    above_root = len(parents)
    hangs_on = torch.eye(len(parents), dtype=dtype)
    for joint in reversed(range(1, len(parents))):
        hangs_on[parents[joint]] += hangs_on[joint]
    ancestors = torch.tensor([above_root, *parents[1:], above_root])
    doubling = []
    while (ancestors != above_root).any():
        doubling.append(ancestors)
        ancestors = ancestors[ancestors]
    basis = torch.eye(3, dtype=dtype)
    cross = torch.stack([torch.linalg.cross(e.expand(3, 3), basis).T for e in basis]).flatten(1)
    return _Tree(torch.tensor([above_root, *parents[1:]]), tuple(doubling), hangs_on, cross, basis)
