"""The avatar: canonical Gaussians, moved by the residual, carried by the skeleton.

1. mu'  = mu + E(mu) psi + MLP(theta)  the expression and the residual, in the rest pose
2. A    = sum_p W_p(mu) T_p(theta)     Eq. 5, W of the outer skin, see :mod:`gva_mi.avatar.skin`
3. mu_t = A mu',   R_t = A_rot R       Eq. 6, see :mod:`gva_mi.body.skinning`
4. f_t  = A_rot f                      the linear band of the colour

Colour turns with the body (4), so that a person who turns before the camera and a camera that
goes around the person agree.

An avatar holds all it takes to drive it: skeleton and surface of the rest body are copied from
the body model, so that a saved avatar is one file and needs no licensed body beside it.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from gva_mi.avatar.canonical import (
    CARRIERS,
    PARAMETERS,
    CanonicalGaussians,
    SeedOptions,
    seed_on_surface,
)
from gva_mi.avatar.residual import PoseResidual, ResidualOptions
from gva_mi.avatar.skin import Skin, diffused
from gva_mi.body.kinematics import joint_transforms
from gva_mi.body.pose import LEFT_HAND, RIGHT_HAND, Pose, Shape
from gva_mi.body.skinning import skin_gaussians
from gva_mi.body.smplx import BodyModel
from gva_mi.errors import InputError
from gva_mi.files import read_arrays, write_arrays
from gva_mi.splat.gaussians import Gaussians

FORMAT = "gva_mi avatar, version 2"
RIG = (  # the tensors of a Rig
    "joints", "vertices", "faces", "weights", "looseness", "expression", "expression_joints",
    "betas",
)  # fmt: skip
# The linear SH band h, in the basis (-y, z, -x), as a vector: its colour is C1 (V h) . d.
_V = ((0.0, 0.0, -1.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0))


@dataclass(frozen=True)
class AvatarOptions:
    """How an avatar is made."""

    seed: SeedOptions = SeedOptions()
    residual: ResidualOptions = ResidualOptions()
    hands: bool = True  # False: fingers stay as in the rest pose (an ablation of the paper)


@dataclass(frozen=True)
class Rig:
    """The rest body of an avatar: its skeleton, and its surface."""

    joints: Tensor  # (55, 3) metres, rest pose
    parents: tuple[int, ...]  # 55, -1 for the root
    vertices: Tensor  # (V, 3) metres, rest pose, displaced by the clothes' offsets
    faces: Tensor  # (F, 3) int64
    weights: Tensor  # (V, 55)
    looseness: Tensor  # (V,) metres by which the clothes' offsets displaced it
    expression: Tensor  # (V, 3, E) metres by which the face's coefficients move the vertices
    expression_joints: Tensor  # (55, 3, E) the same of the joints
    betas: Tensor  # (B,) the shape it was made with
    body: str  # fingerprint of the body model it came from

    @property
    def skin(self) -> Skin:
        """The surface as something that points can follow."""
        return Skin(self.vertices, self.weights, self.expression)


@dataclass(frozen=True)
class Animated:
    """An avatar in one pose."""

    gaussians: Gaussians  # in the world
    residual: Tensor  # (N, 3) metres, rest pose: the MLP(theta) that Eq. 9 keeps small


class Avatar(nn.Module):
    """A drivable 3D Gaussian avatar, ``avatar(pose) -> Gaussians``.

    Attributes:
        canonical: what the person looks like in the rest pose.
        residual: how the rest pose deforms with the pose.
        options: what it was made of.
        rig: the rest body under it, constant.
        skin: the outer surface that Gaussians take their skinning weights from.
    """

    def __init__(
        self,
        canonical: CanonicalGaussians,
        residual: PoseResidual,
        rig: Rig,
        skin: Skin,
        options: AvatarOptions,
    ) -> None:
        super().__init__()
        self.canonical, self.residual, self.options = canonical, residual, options
        self._parents, self._body = rig.parents, rig.body
        for name in RIG:
            self.register_buffer(f"rest_{name}", getattr(rig, name).detach().clone())
        self.wear(skin)
        fingers = torch.zeros(len(rig.parents), 1, dtype=torch.bool)
        fingers[LEFT_HAND] = fingers[RIGHT_HAND] = not options.hands
        self.register_buffer("_held", fingers, persistent=False)
        self.register_buffer("_v", torch.tensor(_V, dtype=rig.joints.dtype), persistent=False)

    @property
    def rig(self) -> Rig:
        """The rest body, in the precision of the avatar."""
        tensors = {name: getattr(self, f"rest_{name}") for name in RIG}
        return Rig(parents=self._parents, body=self._body, **tensors)

    @property
    def skin(self) -> Skin:
        """The outer skin, in the precision of the avatar."""
        return Skin(*(getattr(self, f"skin_{field.name}") for field in fields(Skin)))

    def wear(self, skin: Skin) -> None:
        """Take another outer skin, which the Gaussians are to follow from the next look-up."""
        for field in fields(Skin):
            self.register_buffer(f"skin_{field.name}", getattr(skin, field.name).detach().clone())

    def look_up(self) -> None:
        """Let the Gaussians follow the skin around where they are now."""
        G = self.canonical
        G.weights, G.expression = self.skin.at(G.means)

    def forward(self, pose: Pose) -> Gaussians:
        """The Gaussians of one pose, in the world."""
        return self.animate(pose).gaussians

    def animate(self, pose: Pose) -> Animated:
        """One pose's Gaussians and the residual that went into them.

        Args:
            pose: one frame. Of its expression the coefficients count that the body knew.

        Returns:
            Differentiable in all parameters, and in the pose.
        """
        if len(pose) != 1:
            raise ValueError(f"Avatar: pose must be of one frame, got {len(pose)}")
        rotations = pose.rotations.masked_fill(self._held, 0)
        G = self.canonical
        if self.options.residual.enabled:
            residual = self.residual(G.means, rotations[0])
        else:
            residual = torch.zeros_like(G.means)
        psi = pose.expression[0, : G.expression.shape[2]]
        means = G.means + moved_by(psi, G.expression)
        joints = self.rest_joints + moved_by(psi, self.rest_expression_joints)
        # In float64: of 55 joints it costs nothing, and chains of products lose most of the digits.
        turned, at_rest, transl = (x.double() for x in (rotations, joints, pose.transl))
        T_world_rest = joint_transforms(turned, at_rest, self._parents, transl)[0].to(means.dtype)
        means, quats = skin_gaussians(means + residual, G.quats, G.weights, T_world_rest)
        sh = self.turn_colors(G.sh, T_world_rest)
        return Animated(Gaussians(means, quats, G.scales, G.opacities, sh=sh), residual)

    def turn_colors(self, sh: Tensor, T_world_rest: Tensor) -> Tensor:
        """Spherical harmonics (N, K, 3) whose linear band follows the blended joints (eq. 4)."""
        if sh.shape[1] == 1:
            return sh
        # The change of basis is made for 55 joints, not for N Gaussians. Near a bent joint the
        # blend is no rotation and shortens the band: a little less gloss there is harmless.
        turn = self._v.T @ T_world_rest[:, :3, :3] @ self._v
        turn = (self.canonical.weights @ turn.flatten(1)).unflatten(1, (3, 3))
        return torch.cat([sh[:, :1], turn @ sh[:, 1:]], dim=1)

    def record(self) -> dict[str, Any]:
        """The avatar as tensors and strings, for a file or checkpoint; see :meth:`from_record`."""
        tensors = {name: value.detach().clone() for name, value in self.state_dict().items()}
        described = {"options": asdict(self.options), "parents": self._parents, "body": self._body}
        return {"format": FORMAT, "description": json.dumps(described), **tensors}

    @staticmethod
    def from_record(record: dict[str, Any]) -> Avatar:
        """The avatar that a record was made of, to the bit."""
        if record.get("format") != FORMAT:
            raise ValueError(f"Avatar: 'format' must be '{FORMAT}', got {record.get('format')!r}")
        described = json.loads(record["description"])
        options = AvatarOptions(
            seed=SeedOptions(**described["options"]["seed"]),
            residual=ResidualOptions(**described["options"]["residual"]),
            hands=described["options"]["hands"],
        )
        state = {k: v for k, v in record.items() if k not in ("format", "description")}
        rig = Rig(
            parents=tuple(described["parents"]),
            body=described["body"],
            **{name: state[f"rest_{name}"] for name in RIG},
        )
        skin = Skin(**{f.name: state[f"skin_{f.name}"] for f in fields(Skin)})
        canonical = CanonicalGaussians(
            **{name: state[f"canonical.{name}"] for name in (*PARAMETERS, *CARRIERS)}
        )
        residual = PoseResidual(options.residual, torch.zeros(3), 1.0)
        avatar = Avatar(canonical, residual, rig, skin, options).to(rig.joints.dtype)
        avatar.load_state_dict(state)
        return avatar

    def save(self, path: Path) -> None:
        """Write the avatar to one ``.npz``; an older one is replaced once the new one is whole."""
        write_arrays(path, **{k: np.asarray(v) for k, v in self.record().items()})

    @staticmethod
    def load(path: Path) -> Avatar:
        """Read what :meth:`save` wrote.

        Raises:
            InputError: no such file, or not an avatar.
        """
        arrays = read_arrays(path, "an avatar, as `fit` saves it")
        texts = {key: str(arrays.pop(key, "")) for key in ("format", "description")}
        try:
            return Avatar.from_record(
                {**texts, **{k: torch.from_numpy(v) for k, v in arrays.items()}}
            )
        except (KeyError, TypeError, ValueError, RuntimeError) as error:
            raise InputError(f"{path}: not an avatar of this version ({error})") from None


def moved_by(psi: Tensor, directions: Tensor) -> Tensor:
    """Metres (N, 3) by which coefficients (up to E,) of an expression move along (N, 3, E)."""
    return directions[..., : len(psi)] @ psi


def seed_avatar(
    body: BodyModel,
    shape: Shape,
    offsets: Tensor | None = None,
    options: AvatarOptions = AvatarOptions(),  # noqa: B008 (frozen)
    generator: torch.Generator | None = None,
    colors: Tensor | None = None,
) -> Avatar:
    """A new avatar: Gaussians on the person's rest surface, and a residual of zero.

    Args:
        body: the body model.
        shape: the person's shape.
        offsets: (V, 3) displacement of the rest surface (SMPL-X + D), metres; None: the naked body.
        options: what to make.
        generator: draws the first weights of the residual.
        colors: (V, 3) linear, of the vertices; grey where missing.
    """
    with torch.no_grad():
        rest = body.rest(shape)
        vertices = rest.vertices if offsets is None else rest.vertices + offsets
        looseness = (vertices - rest.vertices).norm(dim=1)
        count, E = len(vertices), body.num_expressions
        expression = body.expression_directions[:, : 3 * count].view(E, 3, count).permute(2, 1, 0)
        own = Skin(vertices, body.weights, expression)
        skin = diffused(vertices.double().numpy(), body.faces.numpy(), own, looseness)
        canonical = seed_on_surface(vertices, body.faces, skin, options.seed, colors)
        low, high = vertices.amin(0), vertices.amax(0)
        center, extent = (low + high) / 2, float((high - low).max() / 2)
        residual = PoseResidual(options.residual, center, extent, generator).to(vertices.dtype)
        fingerprint = hashlib.sha256(body.v_template.numpy().tobytes()).hexdigest()[:16]
        rig = Rig(
            rest.joints,
            tuple(body.parents),
            vertices,
            body.faces,
            body.weights,
            looseness,
            expression,
            body.expression_joints.view(E, -1, 3).permute(1, 2, 0),
            shape.betas,
            fingerprint,
        )
    return Avatar(canonical, residual, rig, skin, options)
