"""The rest body of an avatar: its skeleton and its surface, copied from a body model."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import torch
from torch import Tensor

from gva_mi.avatar.skin_weights import Skin, SkinningOptions, diffused
from gva_mi.body.pose import Shape
from gva_mi.body.smplx import BodyModel

RIG = (  # the tensors of a Rig
    "joints", "vertices", "faces", "weights", "looseness", "directions", "pose_features",
    "expression_joints", "betas",
)  # fmt: skip


@dataclass(frozen=True)
class Rig:
    """Skeleton and surface of a person at rest."""

    joints: Tensor  # (55, 3) metres, rest pose
    parents: tuple[int, ...]  # 55, -1 for the root
    vertices: Tensor  # (V, 3) metres, rest pose, displaced by the clothes' offsets
    faces: Tensor  # (F, 3) int64
    weights: Tensor  # (V, 55)
    looseness: Tensor  # (V,) metres by which the clothes' offsets displaced it
    directions: Tensor  # (V, 3, P + E) metres by which blend shapes move the vertices
    pose_features: Tensor  # (P,) int64, which of the 9 (J - 1) entries of R - I
    expression_joints: Tensor  # (55, 3, E) metres by which expressions move the joints
    betas: Tensor  # (B,) the shape it was made with
    body: str  # the digest of the body model it came from

    def skin(self, options: SkinningOptions) -> Skin:
        """Return the surface itself, as a skin that points can follow."""
        itself = torch.arange(len(self.vertices))
        return Skin(self.vertices, self.weights, itself, self.directions, options)

    def outer_skin(self, options: SkinningOptions) -> Skin:
        """Return the surface as an outer skin: weights spread where clothes are loose."""
        vertices, faces = self.vertices.double().numpy(), self.faces.numpy()
        return diffused(vertices, faces, self.skin(options), self.looseness)

    @staticmethod
    @torch.no_grad()
    def of(body: BodyModel, shape: Shape, offsets: Tensor | None = None) -> Rig:
        """Take the rest body of a person from a body model.

        ``offsets`` (V, 3) displace the rest surface (SMPL-X + D), metres; None: naked.
        """
        rest, count = body.rest(shape), len(body.v_template)
        vertices = rest.vertices if offsets is None else rest.vertices + offsets
        directions = body.frame_directions[:, : 3 * count].view(-1, 3, count).permute(2, 1, 0)
        expressions = body.expression_joints.view(body.num_expressions, -1, 3)
        return Rig(
            joints=rest.joints,
            parents=tuple(body.parents),
            vertices=vertices,
            faces=body.faces,
            weights=body.weights,
            looseness=(vertices - rest.vertices).norm(dim=1),
            directions=directions.contiguous(),
            pose_features=body.pose_features,
            expression_joints=expressions.permute(1, 2, 0).contiguous(),
            betas=shape.betas,
            body=digest(body),
        )


def moved_by(coefficients: Tensor, directions: Tensor) -> Tensor:
    """Return metres (N, 3) that blend shapes (N, 3, K) move points; coefficients are (up to K,)."""
    return directions[..., : len(coefficients)] @ coefficients


def digest(body: BodyModel) -> str:
    """Return a fingerprint of a body model, by which an avatar knows the one it was fitted with."""
    return hashlib.sha256(body.v_template.numpy().tobytes()).hexdigest()[:16]
