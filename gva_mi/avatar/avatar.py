"""The avatar: canonical Gaussians, moved by blend shapes, carried by the skeleton, and lit.

1. mu'  = mu + D(mu) c + MLP(theta)     c = (R_j - I, psi): blend shapes of the body beneath, which
                                        bulge where joints bend and move the face; the residual
2. A    = sum_p W_p(mu) T_p(theta)     Eq. 5; D and W of the outer skin: gva_mi.avatar.skin
3. mu_t = A mu',   Sigma_t             Eq. 6, but that Gaussians stretch with the skin:
                                       gva_mi.avatar.stretch
4. f_t  = f_0 + f_xyz · (A_rotᵀ l)     colour: a linear function of where the light comes from,
                                       gva_mi.avatar.light

3D Gaussian splatting lets colour depend on the direction that it is seen from. Before one camera a
person who turns sees the light go round with it, and both explain the pictures alike. From
elsewhere they differ: the light stays (4), in a direction l of the world, one for all Gaussians,
that is learned with them. Gloss, which moves with the eye, is left out.

An avatar holds all it takes to drive it: skeleton and surface of the rest body are copied from
the body model, so that a saved avatar is one file and needs no licensed body beside it. One that
may be given away is written by :mod:`gva_mi.avatar.formats.without_body`.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
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
from gva_mi.avatar.carry import carry
from gva_mi.avatar.light import lit
from gva_mi.avatar.residual import PoseResidual, ResidualOptions
from gva_mi.avatar.skin import Skin, diffused
from gva_mi.avatar.sound import require_sound
from gva_mi.body.kinematics import turn_joints
from gva_mi.body.polar import carry_frames
from gva_mi.body.pose import LEFT_HAND, RIGHT_HAND, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.core.errors import expecting
from gva_mi.core.files import read_arrays, write_arrays
from gva_mi.splat.gaussians import Gaussians

FORMAT = "gva_mi avatar, version 5"
AVATAR_FILE = "an avatar of this version, as `fit` saves it"  # for errors
RIG = (  # the tensors of a Rig
    "joints", "vertices", "faces", "weights", "looseness", "directions", "pose_features",
    "expression_joints", "betas",
)  # fmt: skip
SKIN_ARRAYS = ("vertices", "weights", "beneath")  # of an outer skin; its directions are the rig's
_LIGHT = (0.6, 0.6, 0.6)  # before anything is learned: along no axis that a person turns about


@dataclass(frozen=True)
class AvatarOptions:
    """How an avatar is made."""

    seed: SeedOptions = SeedOptions()
    residual: ResidualOptions = ResidualOptions()
    hands: bool = True  # False: fingers stay as in the rest pose (an ablation of the paper)
    stretch: bool = True  # False: Gaussians turn and keep their size, as in Eq. 6


@dataclass(frozen=True)
class Rig:
    """The rest body of an avatar: its skeleton, and its surface."""

    joints: Tensor  # (55, 3) metres, rest pose
    parents: tuple[int, ...]  # 55, -1 for the root
    vertices: Tensor  # (V, 3) metres, rest pose, displaced by the clothes' offsets
    faces: Tensor  # (F, 3) int64
    weights: Tensor  # (V, 55)
    looseness: Tensor  # (V,) metres by which the clothes' offsets displaced it
    directions: Tensor  # (V, 3, P + E) metres by which blend shapes move the vertices
    pose_features: Tensor  # (P,) int64, which of the 9 (J - 1) entries of R - I
    expression_joints: Tensor  # (55, 3, E) the same of the joints
    betas: Tensor  # (B,) the shape it was made with
    body: str  # the digest of the body model it came from

    @property
    def skin(self) -> Skin:
        """The surface as something that points can follow."""
        itself = torch.arange(len(self.vertices))
        return Skin(self.vertices, self.weights, itself, self.directions)

    def outer_skin(self) -> Skin:
        """The surface as an outer skin: weights spread where clothes are loose."""
        vertices, faces = self.vertices.double().numpy(), self.faces.numpy()
        return diffused(vertices, faces, self.skin, self.looseness)

    @staticmethod
    @torch.no_grad()
    def of(body: BodyModel, shape: Shape, offsets: Tensor | None = None) -> Rig:
        """The rest body of a person.

        Args:
            body: the body model.
            shape: the person's shape.
            offsets: (V, 3) displacement of the rest surface (SMPL-X + D), metres; None: naked.
        """
        rest, count = body.rest(shape), len(body.v_template)
        vertices = rest.vertices if offsets is None else rest.vertices + offsets
        directions = body.frame_directions[:, : 3 * count].view(-1, 3, count).permute(2, 1, 0)
        return Rig(
            joints=rest.joints,
            parents=tuple(body.parents),
            vertices=vertices,
            faces=body.faces,
            weights=body.weights,
            looseness=(vertices - rest.vertices).norm(dim=1),
            directions=directions.contiguous(),
            pose_features=body.pose_features,
            expression_joints=body.expression_joints.view(body.num_expressions, -1, 3).permute(
                1, 2, 0
            ),
            betas=shape.betas,
            body=digest(body),
        )


@dataclass(frozen=True)
class Driven:
    """What one pose does to all that hangs on the skeleton."""

    coefficients: Tensor  # (P + E,) c of eq. 1
    joints: Tensor  # (55, 3) metres at rest, where the expression has them
    T_world_rest: Tensor  # (55, 4, 4) float64: how skin stretches is told by their differences


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
        light: (3,) direction of l of eq. 4, in the world, of any length.
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
        self.set_skin_weights(skin)
        fingers = torch.zeros(len(rig.parents), 1, dtype=torch.bool)
        fingers[LEFT_HAND] = fingers[RIGHT_HAND] = not options.hands
        self.register_buffer("_held", fingers, persistent=False)
        self.light = nn.Parameter(torch.tensor(_LIGHT, dtype=rig.joints.dtype))

    @property
    def rig(self) -> Rig:
        """The rest body, in the precision of the avatar."""
        tensors = {name: getattr(self, f"rest_{name}") for name in RIG}
        return Rig(parents=self._parents, body=self._body, **tensors)

    @property
    def skin(self) -> Skin:
        """The outer skin, in the precision of the avatar."""
        own = (getattr(self, f"skin_{name}") for name in SKIN_ARRAYS)
        return Skin(*own, self.rest_directions)

    def set_skin_weights(self, skin: Skin) -> None:
        """Take another outer skin, which the Gaussians are to follow from the next look-up."""
        for name in SKIN_ARRAYS:
            self.register_buffer(f"skin_{name}", getattr(skin, name).detach().clone())

    def rebind_weights(self) -> None:
        """Let the Gaussians follow the skin around where they are now."""
        G = self.canonical
        for name, value in self.skin.at(G.means).named().items():
            setattr(G, name, value)

    def forward(self, pose: Pose) -> Gaussians:
        """The Gaussians of one pose, in the world."""
        return self.animate(pose).gaussians

    def animate(self, pose: Pose) -> Animated:
        """One pose's Gaussians and the residual that went into them.

        Args:
            pose: one frame. Of its expression those coefficients count that the body knew.

        Returns:
            Differentiable in all parameters, and in the pose.
        """
        driven, G = self.driven(pose), self.canonical
        if self.options.residual.enabled:
            residual = self.residual(G.means, G.weights, self.followed(pose)[0])
        else:
            residual = torch.zeros_like(G.means)
        means = G.means + G.moved_by(driven.coefficients) + residual
        if not self.options.stretch:
            A, _ = G.blended(driven.T_world_rest, means)
            means, quats = carry_frames(A, means, G.quats)
            sh = lit(G.sh, A, self.light)
            return Animated(Gaussians(means, quats, G.scales, G.opacities, sh=sh), residual)
        own = means, G.quats, G.scales, G.sh, self.light
        means, covars, sh = carry(G.joints, driven.T_world_rest, *own)
        gaussians = Gaussians(means, None, None, G.opacities, sh=sh, covars=covars)
        return Animated(gaussians, residual)

    def driven(self, pose: Pose) -> Driven:
        """Blend shapes and skeleton of one pose, for the Gaussians and for the rig's surface.

        Args:
            pose: as in :meth:`animate`.

        Returns:
            Differentiable in the pose.
        """
        if len(pose) != 1:
            raise ValueError(f"Avatar: pose must be of one frame, got {len(pose)}")
        psi = pose.expression[0, : self.rest_expression_joints.shape[2]]
        joints = self.rest_joints + moved_by(psi, self.rest_expression_joints)
        # In float64: of 55 joints it costs nothing, and chains of products lose digits.
        turned, at_rest, transl = (x.double() for x in (self.followed(pose), joints, pose.transl))
        R, T_world_rest = turn_joints(turned, at_rest, self._parents, transl)
        bent = self.coefficients(R[0].to(self.rest_joints.dtype), psi)
        return Driven(bent, joints, T_world_rest[0])

    def followed(self, pose: Pose) -> Tensor:
        """The rotations (T, 55, 3) that it follows: without hands, fingers stay as at rest."""
        return pose.rotations.masked_fill(self._held, 0)

    def coefficients(self, R: Tensor, psi: Tensor) -> Tensor:
        """c of eq. 1: pose features of rotations (55, 3, 3), then the expression (up to E,)."""
        bent = (R[1:] - torch.eye(3, dtype=R.dtype)).flatten()[self.rest_pose_features]
        return torch.cat([bent, psi])

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
            stretch=described["options"]["stretch"],
        )
        state = {k: v for k, v in record.items() if k not in ("format", "description")}
        require_sound(state, described["parents"])
        rig = Rig(
            parents=tuple(described["parents"]),
            body=described["body"],
            **{name: state[f"rest_{name}"] for name in RIG},
        )
        skin = Skin(*(state[f"skin_{name}"] for name in SKIN_ARRAYS), rig.directions)
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
        return Avatar.from_arrays(path, read_arrays(path, AVATAR_FILE))

    @staticmethod
    def from_arrays(path: Path, arrays: dict[str, np.ndarray]) -> Avatar:
        """The avatar in the arrays of a file; ``path`` is for the error.

        Raises:
            InputError: not an avatar.
        """
        texts = {key: str(arrays.get(key, "")) for key in ("format", "description")}
        with expecting(path, AVATAR_FILE):
            tensors = {k: torch.from_numpy(v) for k, v in arrays.items() if k not in texts}
            return Avatar.from_record({**texts, **tensors})


def moved_by(coefficients: Tensor, directions: Tensor) -> Tensor:
    """Metres (N, 3) that coefficients (up to K,) of blend shapes move along (N, 3, K)."""
    return directions[..., : len(coefficients)] @ coefficients


def digest(body: BodyModel) -> str:
    """What an avatar knows the body model by that it was made with."""
    return hashlib.sha256(body.v_template.numpy().tobytes()).hexdigest()[:16]


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
        rig = Rig.of(body, shape, offsets)
        vertices = rig.vertices
        skin = rig.outer_skin()
        canonical = seed_on_surface(vertices, body.faces, skin, options.seed, colors)
        low, high = vertices.amin(0), vertices.amax(0)
        center, extent = (low + high) / 2, float((high - low).max() / 2)
        residual = PoseResidual(options.residual, center, extent, generator).to(vertices.dtype)
    return Avatar(canonical, residual, rig, skin, options)
