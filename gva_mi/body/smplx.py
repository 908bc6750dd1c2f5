"""The parametric body of Eq. 4: shape and pose to vertices, joints and transforms.

    1. v_shaped = v_template + S β + E ψ                        S, E: shape, expression directions
    2. J = J_regressor · v_shaped
    3. v_rest = v_shaped + offsets + P vec(R(θ_j) − I), j ≥ 1   P: pose directions
    4. vertices = Σ_j w_j T_world_rest[j](θ, J) · v_rest        see gva_mi.body.skinning

==========  ==================================  ===================  ========================
Symbol      Name                                Shape                Unit
==========  ==================================  ===================  ========================
β           ``Shape.betas``                     (B,)                 standard deviations
ψ           ``Pose.expression``                 (T, E)               standard deviations
θ           ``Pose.rotations``                  (T, 55, 3)           radians, axis-angle
w           ``weights``                         (V, 55)              rows sum to 1
—           ``offsets`` (SMPL-X + D)            (V, 3)               metres, rest pose
==========  ==================================  ===================  ========================

Offsets stand for clothes: they move vertices and leave the joints where the naked shape has them.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import roma
import torch
from torch import Tensor, nn

from gva_mi.body.body_file import read_body
from gva_mi.body.hands import HandSpace, with_hands
from gva_mi.body.pose import PARENTS, Pose, Shape
from gva_mi.body.puppet import PUPPET
from gva_mi.body.skinning import rigid_chain, skin_points
from gva_mi.errors import InputError

@dataclass(frozen=True)
class Rest:
    """A person in the T-pose."""

    vertices: Tensor  # (V, 3) metres
    joints: Tensor  # (55, 3) metres


@dataclass(frozen=True)
class Posed:
    """A person in T poses, in the world."""

    vertices: Tensor  # (T, V, 3) metres
    joints: Tensor  # (T, 55, 3) metres
    T_world_rest: Tensor  # (T, 55, 4, 4) takes the rest pose to the world, joint by joint


class BodyModel(nn.Module):
    """A body in SMPL-X's format, ``body(pose, shape, offsets) -> Posed``.

    All its numbers are buffers, of one precision: ``body.to(torch.float64)`` changes it. Nothing
    in it trains.

    Attributes:
        v_template: (V, 3) the mean person in the T-pose, metres.
        faces: (F, 3) int64, counter-clockwise seen from outside.
        weights: (V, 55) skinning weights.
        parents: 55 indices, -1 for the root.
        hands_mean: (2, 45) the mean left and right hand of the file, axis-angle.
        num_betas, num_expressions: how many coefficients the file has; missing ones count as zero.
    """

    parents: tuple[int, ...] = PARENTS

    def __init__(self, arrays: dict[str, np.ndarray], dtype: torch.dtype = torch.float32) -> None:
        """From the arrays of a file, whose names and shapes :func:`load_body` has checked."""
        super().__init__()
        tensor = lambda array: torch.from_numpy(np.ascontiguousarray(array)).to(dtype)
        directions = _rows(arrays["shapedirs"])
        betas, expressions = _columns(len(directions))
        self.register_buffer("v_template", tensor(arrays["v_template"]))
        self.register_buffer("faces", torch.from_numpy(arrays["f"].astype(np.int64)))
        self.register_buffer("weights", tensor(arrays["weights"]))
        self.register_buffer("shape_directions", tensor(directions[betas]))  # (B, 3 V)
        self.register_buffer("expression_directions", tensor(directions[expressions]))  # (E, 3 V)
        # Joints are linear in the coefficients too: regress the directions once, not every frame.
        regressor = arrays["J_regressor"].astype(np.float64)
        joints = regressor @ arrays["shapedirs"].reshape(len(arrays["v_template"]), -1)
        joints = joints.reshape(165, -1).T
        self.register_buffer("j_template", tensor(regressor @ arrays["v_template"]))
        self.register_buffer("shape_joints", tensor(joints[betas]))  # (B, 165)
        self.register_buffer("expression_joints", tensor(joints[expressions]))  # (E, 165)
        used = np.flatnonzero(arrays["posedirs"].any((0, 1)))  # only these cost time
        self.register_buffer("pose_features", torch.from_numpy(used))
        self.register_buffer("pose_directions", tensor(_rows(arrays["posedirs"][..., used])))
        self.register_buffer(
            "hands_mean", tensor(np.stack([arrays["hands_meanl"], arrays["hands_meanr"]]))
        )

    @property
    def num_betas(self) -> int:
        return len(self.shape_directions)

    @property
    def num_expressions(self) -> int:
        return len(self.expression_directions)

    def rest(self, shape: Shape, expression: Tensor | None = None) -> Rest:
        """The person in the T-pose (eq. 1, 2).

        Args:
            shape: betas (B,), B up to ``num_betas``.
            expression: (E,), or None for a neutral face.
        """
        vertices, joints = self._shaped(shape)
        if expression is not None:
            dv, dj = self._expressed(expression[None])
            vertices, joints = vertices + dv[0], joints + dj[0]
        return Rest(vertices.contiguous(), joints)

    def forward(self, pose: Pose, shape: Shape, offsets: Tensor | None = None) -> Posed:
        """The person in the world (eq. 1-4), differentiable in everything that is given.

        Args:
            pose: T frames; the expression may have fewer coefficients than the file.
            shape: betas (B,), B up to ``num_betas``.
            offsets: (V, 3) added in the rest pose, metres.
        """
        if offsets is not None and offsets.shape != self.v_template.shape:
            raise ValueError(
                f"BodyModel(): offsets must be {tuple(self.v_template.shape)}, "
                f"got {tuple(offsets.shape)}"
            )
        vertices, joints = self._shaped(shape)
        dv, dj = self._expressed(pose.expression)
        vertices, joints = (vertices if offsets is None else vertices + offsets) + dv, joints + dj
        rotations = pose.rotations
        if len(self.pose_features):
            vertices = vertices + self._corrected(rotations)
        T_world_rest = joint_transforms(rotations, joints, self.parents, pose.transl)
        skinned = skin_points(vertices, self.weights, T_world_rest)
        R, t = T_world_rest[..., :3, :3], T_world_rest[..., :3, 3]
        return Posed(skinned, (R @ joints.unsqueeze(-1)).squeeze(-1) + t, T_world_rest)

    def add_mean_hands(self, pose: Pose) -> Pose:
        """A pose whose hands count from the file's mean hand, as estimators write them, made to
        count from flat."""
        rotations = torch.cat(
            [pose.rotations[:, :25].flatten(1), pose.left_hand_pose + self.hands_mean[0],
             pose.right_hand_pose + self.hands_mean[1]], dim=1,
        )  # fmt: skip
        return Pose.from_rotations(rotations.unflatten(1, (55, 3)), pose.transl, pose.expression)

    def _shaped(self, shape: Shape) -> tuple[Tensor, Tensor]:
        betas = _coefficients("betas", shape.betas[None], self.num_betas)
        k = betas.shape[1]
        vertices = (betas @ self.shape_directions[:k]).view(3, -1).mT
        joints = (betas @ self.shape_joints[:k]).view(-1, 3)
        return self.v_template + vertices, self.j_template + joints

    def _expressed(self, expression: Tensor) -> tuple[Tensor, Tensor]:
        psi = _coefficients("expression", expression, self.num_expressions)
        k, frames = psi.shape[1], len(psi)
        vertices = (psi @ self.expression_directions[:k]).view(frames, 3, -1).mT
        joints = (psi @ self.expression_joints[:k]).view(frames, -1, 3)
        return vertices, joints

    def _corrected(self, rotations: Tensor) -> Tensor:
        R = roma.rotvec_to_rotmat(rotations[:, 1:])
        bent = (R - torch.eye(3, dtype=R.dtype)).flatten(1)
        # The features are distinct, so that this index has a gradient without collisions.
        return (bent[:, self.pose_features] @ self.pose_directions).unflatten(1, (3, -1)).mT


def load_body(path: Path | None = None, dtype: torch.dtype = torch.float32) -> BodyModel:
    """Read a body: a file in SMPL-X's npz format, or the built-in puppet where none is given.

    Args:
        path: ``SMPLX_NEUTRAL.npz`` or the like, version 1.0 or 1.1, any gender. Files with 400
            shape directions hold 300 betas and then expressions; files with fewer hold 10 betas
            and then up to 10 expressions.
        dtype: float32 or float64.

    Raises:
        InputError: naming the file, the key, and the shape that was found.
    """
    return BodyModel(read_body(PUPPET if path is None else Path(path)), dtype)


def _rows(directions: np.ndarray) -> np.ndarray:
    """Directions (V, 3, K), one in each row: all x, then all y, then all z, (K, 3 V)."""
    return directions.transpose(2, 1, 0).reshape(directions.shape[2], -1)


def _coefficients(name: str, values: Tensor, available: int) -> Tensor:
    """Coefficients (T, K) cut to what the file has; missing ones count as zero by not being
    there."""
    if values.shape[1] > available and bool((values[:, available:] != 0).any()):
        raise InputError(
            f"the pose or shape has {values.shape[1]} {name}, but the body file has {available}"
        )
    return values[:, :available]
