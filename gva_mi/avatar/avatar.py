"""The avatar: canonical Gaussians, moved by blend shapes, skinned to the skeleton, and lit.

1. mu'  = mu + D(mu) c + MLP(theta)     c = (R_j - I, psi): the body's blend shapes, which bulge
                                        where joints bend and move the face; and the residual
2. A    = sum_p W_p(mu) T_p(theta)     Eq. 5; D and W of the outer skin: gva_mi.avatar.rig
3. mu_t = A mu',   Sigma_t             Eq. 6, but Gaussians stretch with the skin:
                                       gva_mi.avatar.skin_gaussians
4. f_t  = f_0 + f_xyz · (A_rotᵀ l)     colour: linear in the direction of the light,
                                       gva_mi.avatar.skin_gaussians

In 3D Gaussian splatting colour depends on the viewing direction. If a person turns before one
camera, a light that turns along explains the pictures as well; only other views tell the two
apart. Here the light stays (4), in one direction l of the world that is learned with the Gaussians.
Gloss, which moves with the camera, is left out; ``color="view"`` is as in 3D Gaussian splatting.

An avatar file holds all that is needed to drive it: skeleton and surface of the rest body are
copied from the body model. :mod:`gva_mi.avatar.without_body` writes one without them.

Sources: eq. 1-3 are Sec. 4.1 of the paper (Eq. 5 and 6); what depends on the light is ours.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor, nn

from gva_mi.avatar.canonical import (
    BINDING,
    PARAMETERS,
    CanonicalGaussians,
    SeedOptions,
    seed_on_surface,
)
from gva_mi.avatar.lbs_reference import lbs_transforms, lit
from gva_mi.avatar.residual import PoseResidual, ResidualOptions
from gva_mi.avatar.rig import RIG_TENSORS, Rig, Skin, SkinningOptions, moved_by
from gva_mi.avatar.skin_gaussians import light_vector, skin_gaussians
from gva_mi.body.kinematics import turn_joints
from gva_mi.body.polar import apply_lbs
from gva_mi.body.pose import JOINTS, LEFT_HAND, RIGHT_HAND, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.core.errors import expecting
from gva_mi.core.files import (
    read_arrays,
    require_array,
    shape_fault,
    write_arrays,
)
from gva_mi.core.options import PythonOnly, from_json
from gva_mi.splat.gaussians import Gaussians
from gva_mi.splat.options import SplatOptions

FORMAT = "gva_mi avatar, version 5"
AVATAR_FILE = "an avatar of this version, as `fit` saves it"  # for errors
SKIN_ARRAYS = ("vertices", "weights", "beneath")  # of an outer skin; its directions are the rig's
# How all avatars are splatted. Blur in pixels², chosen: the area of a pixel has a variance of 1/12,
# and the 0.3 of 3DGS makes outlines wider than in pictures.
AVATAR_SPLATTING = SplatOptions(blur=0.1, depth=False)
_FIRST_LIGHT = (0.6, 0.6, 0.6)  # before it is learned; chosen: no axis that a person turns about


@dataclass(frozen=True)
class AvatarOptions:
    """Options of a new avatar.

    Example:
        >>> AvatarOptions(SeedOptions(count=5000), stretch=False).seed.count
        5000
    """

    seed: SeedOptions = SeedOptions()
    residual: ResidualOptions = ResidualOptions()
    # False: fingers stay as in the rest pose (an ablation of the paper).
    hands: PythonOnly[bool] = True
    stretch: PythonOnly[bool] = True  # False: Gaussians turn and keep their size, as in Eq. 6
    # What colour depends on: the light's direction, or the view's (harmonics of degree 1).
    color: PythonOnly[Literal["light", "view"]] = "light"
    skinning: SkinningOptions = SkinningOptions()


@dataclass(frozen=True)
class PosedSkeleton:
    """Blend shapes and joints in T poses, from :meth:`Avatar.posed_skeleton`.

    Example:
        >>> from gva_mi.body.smplx import load_body
        >>> options = AvatarOptions(SeedOptions(count=500))
        >>> avatar = seed_avatar(load_body(), Shape(torch.zeros(10)), options=options)
        >>> skeleton = avatar.posed_skeleton(Pose.rest(frames=2))
        >>> skeleton.coefficients.abs().max(), skeleton.T_world_rest.shape  # nothing bends
        (tensor(0.), torch.Size([2, 55, 4, 4]))
    """

    rotations: Tensor  # (T, 55, 3) axis-angle, as applied
    coefficients: Tensor  # (T, P + E) c of eq. 1
    joints: Tensor  # (T, 55, 3) metres, at rest, moved by the expression
    T_world_rest: Tensor  # (T, 55, 4, 4) float64: skin stretches by their differences


@dataclass(frozen=True)
class Animated:
    """An avatar in one pose, from :meth:`Avatar.animate`.

    Example:
        >>> from gva_mi.body.smplx import load_body
        >>> options = AvatarOptions(SeedOptions(count=500))
        >>> avatar = seed_avatar(load_body(), Shape(torch.zeros(10)), options=options)
        >>> animated = avatar.animate(Pose.rest())
        >>> len(animated.gaussians), len(animated.residual)  # it is off by default
        (500, 0)
    """

    gaussians: Gaussians  # in the world
    # (N, 3) metres, rest pose: the MLP(theta) that Eq. 9 keeps small; (0, 3) without the network
    residual: Tensor


class Avatar(nn.Module):
    """A drivable 3D Gaussian avatar, ``avatar(pose) -> Gaussians``.

    Attributes:
        canonical: Gaussians of the person in the rest pose.
        residual: deformation of the rest pose by the pose.
        light: (3,) direction of l of eq. 4, in the world, of any length.
        options: those it was made with.
        rig: the rest body under it, constant.
        skin: the outer surface that Gaussians take their skinning weights from.

    Example:
        An avatar of 500 Gaussians in the T-pose, one metre up, and from a file.

        >>> import tempfile
        >>> from gva_mi.body.smplx import load_body
        >>> options = AvatarOptions(SeedOptions(count=500))
        >>> avatar = seed_avatar(load_body(), Shape(torch.zeros(10)), options=options)
        >>> up = Pose(torch.zeros(1, 55, 3), torch.tensor([[0.0, 1, 0]]), torch.zeros(1, 10))
        >>> moved = avatar(up).means - avatar(Pose.rest()).means
        >>> moved.detach().mean(0).round(decimals=3).abs()
        tensor([0., 1., 0.])
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     avatar.save(Path(folder) / "avatar.npz")
        ...     loaded = Avatar.load(Path(folder) / "avatar.npz")
        >>> torch.equal(loaded(up).means, avatar(up).means)
        True
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
        for name in RIG_TENSORS:
            self.register_buffer(f"rest_{name}", getattr(rig, name).detach().clone())
        self.set_skin_weights(skin)
        at_rest = torch.zeros(len(rig.parents), 1, dtype=torch.bool)
        at_rest[LEFT_HAND] = at_rest[RIGHT_HAND] = not options.hands
        self.register_buffer("_joints_at_rest", at_rest, persistent=False)
        self.light = nn.Parameter(torch.tensor(_FIRST_LIGHT, dtype=rig.joints.dtype))

    @property
    def rig(self) -> Rig:
        """The rest body, in the precision of the avatar."""
        tensors = {name: getattr(self, f"rest_{name}") for name in RIG_TENSORS}
        return Rig(parents=self._parents, body=self._body, **tensors)

    @property
    def skin(self) -> Skin:
        """The outer skin, in the precision of the avatar."""
        arrays = (getattr(self, f"skin_{name}") for name in SKIN_ARRAYS)
        return Skin(*arrays, self.rest_directions, self.options.skinning)

    def set_skin_weights(self, skin: Skin) -> None:
        """Replace the outer skin; Gaussians follow it once their weights are bound again."""
        for name in SKIN_ARRAYS:
            self.register_buffer(f"skin_{name}", getattr(skin, name).detach().clone())

    def rebind_weights(self) -> None:
        """Bind the Gaussians to the outer skin around where they are now."""
        G = self.canonical
        for name, value in self.skin.bind(G.means).items():
            setattr(G, name, value)

    def forward(self, pose: Pose) -> Gaussians:
        """Return the Gaussians of one pose, in the world."""
        return self.animate(pose).gaussians

    def animate(self, pose: Pose, sh: Tensor | None = None) -> Animated:
        """Return the Gaussians of one pose and the residual that went into them.

        Args:
            pose: one frame. Expression coefficients that the body does not have are ignored.
            sh: colours of the Gaussians, in the shape of ``canonical.sh``; None: its own.

        Returns:
            Differentiable in all parameters, in the pose, and in the colours.
        """
        return self.skin_to(self.posed_skeleton(pose), sh)

    def skin_to(self, skeleton: PosedSkeleton, sh: Tensor | None = None) -> Animated:
        """Return what :meth:`animate` does, from the skeleton in one pose."""
        if len(skeleton.T_world_rest) != 1:
            raise ValueError(f"Avatar: pose must be of one frame, got {len(skeleton.T_world_rest)}")
        G = self.canonical
        sh = G.sh if sh is None else sh
        means, residual = G.means + G.moved_by(skeleton.coefficients[0]), G.means.new_zeros(0, 3)
        if self.options.residual.enabled:
            residual = self.residual(G.means, G.weights, skeleton.rotations[0])
            means = means + residual
        T = skeleton.T_world_rest[0]
        if self.options.stretch:
            means, covars, lit_sh = skin_gaussians(
                G.sparse_weights, T, means, G.quats, G.scales, sh, self.light
            )
            quats = scales = None
        else:
            A, _ = lbs_transforms(G.sparse_weights, T[:, :3].flatten(1), means)
            lit_sh = lit(sh, A, light_vector(self.light))
            means, quats = apply_lbs(A, means, G.quats)
            scales, covars = G.scales, None
        colors = lit_sh if self.options.color == "light" else sh
        gaussians = Gaussians(means, quats, scales, G.opacities, sh=colors, covars=covars)
        return Animated(gaussians, residual)

    def posed_skeleton(self, pose: Pose) -> PosedSkeleton:
        """Pose blend shapes and skeleton, for the Gaussians and for the rig's surface.

        Args:
            pose: T frames. Expression coefficients that the body does not have are ignored.

        Returns:
            Differentiable in the pose.
        """
        rotations = self.applied_rotations(pose)
        psi = pose.expression[:, : self.rest_expression_joints.shape[2]]
        joints = self.rest_joints + moved_by(psi, self.rest_expression_joints)
        # In float64: cheap for 55 joints, and chains of products lose digits.
        turned, at_rest, transl = (x.double() for x in (rotations, joints, pose.transl))
        R, T_world_rest = turn_joints(turned, at_rest, self._parents, transl)
        R = R.to(joints)
        bent = (R[:, 1:] - torch.eye(3, dtype=R.dtype)).flatten(1)[:, self.rest_pose_features]
        coefficients = torch.cat([bent, psi], dim=1)
        return PosedSkeleton(rotations, coefficients, joints, T_world_rest)

    def applied_rotations(self, pose: Pose) -> Tensor:
        """Return the rotations (T, 55, 3) to apply; without hands, fingers stay at rest."""
        return pose.rotations.masked_fill(self._joints_at_rest, 0)

    def record(self) -> dict[str, Any]:
        """Return the avatar as tensors and strings, for a file; see :meth:`from_record`."""
        tensors = {name: value.detach().clone() for name, value in self.state_dict().items()}
        described = {"options": asdict(self.options), "parents": self._parents, "body": self._body}
        return {"format": FORMAT, "description": json.dumps(described), **tensors}

    @staticmethod
    def from_record(record: dict[str, Any]) -> Avatar:
        """Restore the avatar of a record, to the bit."""
        if record.get("format") != FORMAT:
            raise ValueError(f"Avatar: 'format' must be '{FORMAT}', got {record.get('format')!r}")
        described = json.loads(record["description"])
        options = from_json(AvatarOptions, described["options"])
        state = {k: v for k, v in record.items() if k not in ("format", "description")}
        require_valid(state, described["parents"])
        tensors = {name: state[f"rest_{name}"] for name in RIG_TENSORS}
        rig = Rig(parents=tuple(described["parents"]), body=described["body"], **tensors)
        arrays = (state[f"skin_{name}"] for name in SKIN_ARRAYS)
        skin = Skin(*arrays, rig.directions, options.skinning)
        kept = {name: state[f"canonical.{name}"] for name in (*PARAMETERS, *BINDING)}
        canonical = CanonicalGaussians(**kept)
        residual = PoseResidual(options.residual, torch.zeros(3), 1.0)
        avatar = Avatar(canonical, residual, rig, skin, options).to(rig.joints.dtype)
        require_same_form(state, avatar.state_dict())
        avatar.load_state_dict(state)
        return avatar

    def save(self, path: Path) -> None:
        """Write the avatar to one ``.npz``, atomically."""
        write_arrays(path, **{k: np.asarray(v) for k, v in self.record().items()})

    @staticmethod
    def load(path: Path) -> Avatar:
        """Read a file of :meth:`save`; any other content is an InputError."""
        return Avatar.from_arrays(path, read_arrays(path, AVATAR_FILE))

    @staticmethod
    def from_arrays(path: Path, arrays: dict[str, np.ndarray]) -> Avatar:
        """Restore the avatar in the arrays of a file; ``path`` is for the InputError."""
        with expecting(path, AVATAR_FILE):
            texts = {key: str(arrays[key]) for key in ("format", "description")}
            return Avatar.from_record({**tensors_of(path, arrays), **texts})


def seed_avatar(
    body: BodyModel,
    shape: Shape,
    offsets: Tensor | None = None,
    options: AvatarOptions = AvatarOptions(),  # noqa: B008 (frozen)
    generator: torch.Generator | None = None,
    colors: Tensor | None = None,
) -> Avatar:
    """Make a new avatar: Gaussians on the person's rest surface, and a residual of zero.

    Args:
        body: the body model.
        shape: the person's shape.
        offsets: (V, 3) displacement of the rest surface (SMPL-X + D), metres; None: the naked body.
        options: of the avatar.
        generator: draws the first weights of the residual.
        colors: (V, 3) linear, of the vertices; None: grey.

    Example:
        >>> from gva_mi.body.smplx import load_body
        >>> options = AvatarOptions(SeedOptions(count=500))
        >>> avatar = seed_avatar(load_body(), Shape(torch.zeros(10)), options=options)
        >>> gaussians = avatar(Pose.rest())  # in the T-pose, ready for gva_mi.splat.render
        >>> len(gaussians), avatar.rig.vertices.shape
        (500, torch.Size([10989, 3]))
    """
    with torch.no_grad():
        rig = Rig.of(body, shape, offsets)
        vertices = rig.vertices
        skin = rig.outer_skin(options.skinning)
        canonical = seed_on_surface(vertices, body.faces, skin, options.seed, colors)
        low, high = vertices.amin(0), vertices.amax(0)
        center, extent = (low + high) / 2, float((high - low).max() / 2)
        residual = PoseResidual(options.residual, center, extent, generator).to(vertices.dtype)
    return Avatar(canonical, residual, rig, skin, options)


TEXT_ARRAYS = {"format", "description"}  # of an avatar's file
WHOLE_NUMBER_ARRAYS = {"rest_faces", "rest_pose_features", "skin_beneath", "beneath"}
LARGEST_NUMBER = 1e6  # in a file; chosen: far beyond metres, angles and logits of any avatar
LARGEST_LOG_SCALE = 20  # logarithm of metres; chosen: its exponential is finite in float32
# Of a vertex's sum of skinning weights, and below zero; chosen as in bodies.
WEIGHT_TOLERANCE = 0.01


def tensors_of(path: Path, arrays: Mapping[str, np.ndarray]) -> dict[str, Tensor]:
    """Return the arrays of a file as float32, or as whole numbers, without its texts.

    Example:
        >>> arrays = {"light": np.zeros(3), "format": np.array(FORMAT)}
        >>> tensors_of(Path("avatar.npz"), arrays)
        {'light': tensor([0., 0., 0.])}
    """
    tensors = {}
    for name, array in arrays.items():
        if name not in TEXT_ARRAYS:
            kind, dtype = ("iu", np.int64) if name in WHOLE_NUMBER_ARRAYS else ("f", np.float32)
            array = require_array(path, name, array, kind=kind).astype(dtype, copy=False)
            tensors[name] = torch.from_numpy(array)
    return tensors


def require_same_form(state: Mapping[str, Tensor], expected: Mapping[str, Tensor]) -> None:
    """Raise a ValueError unless a state has the names and shapes of an avatar's ``own``.

    Example:
        >>> require_same_form({}, {"light": torch.zeros(3)})
        Traceback (most recent call last):
        ValueError: 'light' is missing
    """
    for name in sorted(state.keys() ^ expected.keys()):
        raise ValueError(f"'{name}' is {'missing' if name in expected else 'unknown'}")
    for name, x in expected.items():
        if fault := shape_fault(state[name].shape, tuple(x.shape)):
            raise ValueError(f"'{name}' {fault}")


def require_valid(state: Mapping[str, Tensor], parents: Sequence[int]) -> None:
    """Refuse tensors of an avatar's record whose numbers would fail later, or draw nothing.

    Raises:
        ValueError: names the first thing that is wrong.

    Example:
        >>> require_valid({"light": torch.tensor([0, 0, torch.inf])}, parents=[-1])
        Traceback (most recent call last):
        ValueError: 'light' must hold finite numbers of at most 1,000,000.0
    """
    for name, x in state.items():
        largest = LARGEST_LOG_SCALE if name == "canonical.log_scales" else LARGEST_NUMBER
        if x.is_complex() or x.is_floating_point() and not (x.abs() <= largest).all():
            raise ValueError(f"'{name}' must hold finite numbers of at most {largest:,}")
    J, V, N = len(JOINTS), len(state["rest_vertices"]), len(state["canonical.means"])
    shapes = {  # None: any number
        "rest_joints": (J, 3), "rest_vertices": (V, 3), "rest_weights": (V, J),
        "rest_faces": (None, 3), "rest_looseness": (V,), "rest_directions": (V, 3, None),
        "rest_pose_features": (None,), "rest_expression_joints": (J, 3, None),
        "rest_betas": (None,), "canonical.means": (N, 3), "canonical.quats": (N, 4),
        "canonical.log_scales": (N, 3), "canonical.logit_opacities": (N,),
        "canonical.sh": (N, 4 if state["canonical.sh"].shape[1:2] == (4,) else 1, 3),
        "canonical.weights": (N, J), "canonical.slopes": (N, 3, J),
        "canonical.directions": (N, 3, None), "light": (3,),
    }  # fmt: skip
    for name, shape in shapes.items():
        if fault := shape_fault(state[name].shape, shape):
            raise ValueError(f"'{name}' {fault}")
    ends = {"rest_faces": V, "skin_beneath": V, "rest_pose_features": 9 * (J - 1)}
    for name, end in ends.items():
        numbers = state[name]
        outside = numbers.numel() and not 0 <= int(numbers.min()) <= int(numbers.max()) < end
        if numbers.is_floating_point() or outside:
            raise ValueError(f"'{name}' must be whole numbers from 0 to {end - 1}")
    weights = state["rest_weights"]
    if weights.min() < -WEIGHT_TOLERANCE or ((weights.sum(1) - 1).abs() > WEIGHT_TOLERANCE).any():
        raise ValueError("'rest_weights' must be shares that sum to 1 for each vertex")
    before = all(type(p) is int and 0 <= p < k for k, p in enumerate(parents[1:], 1))
    if len(parents) != J or parents[0] != -1 or not before:
        raise ValueError("'parents' must be -1 for the root, and an earlier joint for the others")
