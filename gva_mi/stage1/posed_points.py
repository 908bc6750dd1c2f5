"""Points on a posed body, with derivatives with respect to pose, shape and constant offsets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from gva_mi.body.kinematics import turn_joints
from gva_mi.body.pose import PARENTS
from gva_mi.body.smplx import BodyModel
from gva_mi.core.cpu import sqrt

JOINT_COUNT = len(PARENTS)


@dataclass(frozen=True)
class PointSet:
    """P points at rest, each moved by one joint, and the joints at rest; float64, metres.

    Attributes:
        joints: (P,) the joint that moves each point.
        rest: (P, 3) places of the points in the mean person.
        directions: (B, P, 3) their change per beta.
        skeleton: (55, 3) places of the joints in the mean person.
        growth: (B, 55, 3) their change per beta.
        above: (P, 55) whether the joint, or a child of it, moves the point.
    """

    joints: Tensor
    rest: Tensor
    directions: Tensor
    skeleton: Tensor
    growth: Tensor
    above: Tensor

    @staticmethod
    def of(body: BodyModel, joints: Tensor, rest: Tensor, directions: Tensor) -> PointSet:
        """Take points of a body, given by their first three fields."""
        ancestors = torch.eye(JOINT_COUNT, dtype=torch.bool)
        for joint, parent in enumerate(PARENTS[1:], start=1):
            ancestors[joint] |= ancestors[parent]
        growth = body.shape_joints.view(-1, JOINT_COUNT, 3)
        numbers = (rest, directions, body.j_template, growth)
        return PointSet(joints, *(x.double() for x in numbers), ancestors[joints])


@dataclass(frozen=True)
class PosedPoints:
    """P points on a posed body in n frames, with derivatives.

    The derivatives are with respect to pose, shape and constant offsets.

    Let ``[A_d | t_d]`` be the transform of the joint ``d`` that moves a point, ``p_j`` the places
    of the joints, and ``Ω_j`` the axes about which the unknowns turn joint ``j``:

    1. ``X = A_d (x + o) + t_d``
    2. ``∂X/∂r_j = -[X - p_j]× Ω_j``                            for ``j`` = ``d`` and its ancestors
    3. ``Ω_j = A_parent J_l(r_j)``,  ``J_l(r) = I + b [r]× + c [r]×²``; ``Ω_0 = A_0`` of the root
    4. ``∂X/∂β = A_d ∂x/∂β + Σ_j (A_parent - A_j) ∂J_j/∂β``        ``A_parent`` of the root: zero
    5. ``∂X/∂o = A_d``

    An unknown is added to the axis-angle of its joint. The root may turn all around, so its
    unknown is a further rotation instead: ``R_0 exp(δ)``. The root is placed by its joint, so
    ``A_parent`` is zero there in (4).

    Attributes:
        points: at rest.
        X: (n, P, 3) places of the points, metres.
        A: (n, 55, 3, 3) rotations of the joints.
        places: (n, 55, 3) of the joints, metres.
        rotations: (n, 55, 3) axis-angle.
    """

    points: PointSet
    X: Tensor
    A: Tensor
    places: Tensor
    rotations: Tensor

    @staticmethod
    def of(
        points: PointSet, rotations: Tensor, place: Tensor, betas: Tensor, offsets: Tensor
    ) -> PosedPoints:
        """Pose points (eq. 1).

        Args:
            points: P points at rest.
            rotations: (n, 55, 3) axis-angle.
            place: (n, 3) of the root joint, metres.
            betas: (B,).
            offsets: (P, 3) metres.
        """
        joints = points.skeleton + torch.einsum("b,bjc->jc", betas, points.growth)
        x = points.rest + torch.einsum("b,bpc->pc", betas, points.directions) + offsets
        T = turn_joints(rotations, joints[None], PARENTS, place - joints[0])[1]
        A, t = T[..., :3, :3], T[..., :3, 3]
        d = points.joints
        X = (A[:, d] @ x[:, :, None])[..., 0] + t[:, d]
        return PosedPoints(points, X, A, (A @ joints[:, :, None])[..., 0] + t, rotations)

    def by_joints(self, joints: Sequence[int]) -> Tensor:
        """Return the derivatives (n, P, 3, F, 3) by F joints, eq. 2."""
        turned = list(joints)
        r = self.rotations[:, turned]
        parents = [PARENTS[j] for j in turned]
        above = self.A[:, parents]  # of the root: overwritten below
        axes = above @ _left_jacobian(r)
        if 0 in turned:
            axes[:, turned.index(0)] = self.A[:, 0]
        arm = self.X[:, :, None] - self.places[:, None, turned]
        arm = arm * self.points.above[:, turned, None]
        moved = torch.linalg.cross(axes.mT[:, None], arm[:, :, :, None])  # rows: axes
        return moved.permute(0, 1, 4, 2, 3)

    def by_betas(self) -> Tensor:
        """Return the derivatives (n, P, 3, B) by betas, eq. 4."""
        points = self.points
        above = torch.cat([torch.zeros_like(self.A[:, :1]), self.A[:, list(PARENTS[1:])]], 1)
        moved = (above - self.A) @ points.growth.permute(1, 2, 0)
        moved = torch.einsum("pj,njcb->npcb", points.above.to(moved), moved)
        return moved + self.by_offsets() @ points.directions.permute(1, 2, 0)

    def by_offsets(self) -> Tensor:
        """Return the derivatives (n, P, 3, 3) by offsets, eq. 5."""
        return self.A[:, self.points.joints]


def _left_jacobian(r: Tensor) -> Tensor:
    """Return ``J_l`` (..., 3, 3) of axis-angles (..., 3)."""
    square = r.square().sum(-1)[..., None, None]
    angle = sqrt(square) / torch.pi
    b = torch.sinc(angle / 2).square() / 2
    c = torch.where(square > 1e-8, (1 - torch.sinc(angle)) / square.clamp_min(1e-12), 1 / 6)
    zero = torch.zeros_like(r[..., 0])
    x, y, z = r.unbind(-1)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).unflatten(-1, (3, 3))
    return torch.eye(3, dtype=r.dtype) + b * cross + c * (cross @ cross)
