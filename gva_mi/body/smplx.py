"""The parametric body of Eq. 4: from shape and pose to vertices, joints and transforms.

    1. v_shaped = v_template + S β + E ψ                        S, E: shape, expression directions
    2. J = J_regressor · v_shaped
    3. v_rest = v_shaped + offsets + P vec(R(θ_j) − I), j ≥ 1   P: pose directions
    4. vertices = Σ_j w_j T_world_rest[j](θ, J) · v_rest        see kinematics and skinning

==========  ==================================  ===================  ========================
Symbol      Name                                Shape                Unit
==========  ==================================  ===================  ========================
β           ``Shape.betas``                     (B,)                 standard deviations
ψ           ``Pose.expression``                 (T, E)               standard deviations
θ           ``Pose.rotations``                  (T, 55, 3)           radians, axis-angle
w           ``weights``                         (V, 55)              rows sum to 1
—           ``offsets`` (SMPL-X + D)            (V, 3)               metres, rest pose
==========  ==================================  ===================  ========================

Offsets represent clothes: they move vertices but not joints.

Sources: eq. 1-4 are SMPL-X (Pavlakos et al., "Expressive Body Capture", 2019), after SMPL (Loper et
al., 2015); offsets are those of Alldieck et al., "Video Based Reconstruction of 3D People Models",
2018.

Blend shapes are a surface plus a weighted sum of directions:

    5. x = x₀ + Σ_k c_k D_k
    6. grad_c_k = ⟨grad_x, D_k⟩,    grad_x₀ = grad_x

A body of 10,000 vertices has 58 MB of pose directions, so reading them takes most of a frame's
time. Torch multiplies a vector by a matrix on one core. Halves of the surface as a batch of two
products use two cores, take half the time, and give the same bits on any number of cores.

Example:
    >>> body = load_body()  # the built-in body, without a licence
    >>> posed = body(Pose.rest(frames=2), Shape(torch.zeros(10)))
    >>> posed.vertices.shape, posed.joints.shape
    (torch.Size([2, 10989, 3]), torch.Size([2, 55, 3]))
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn
from torch.autograd.function import FunctionCtx
from torch.nn.functional import pad

from gva_mi.body.body_file import BUILT_IN_BODY, kintree_table, read_body
from gva_mi.body.kinematics import joint_places, turn_joints
from gva_mi.body.pose import PARENTS, Pose, Shape
from gva_mi.body.skinning import skin_points
from gva_mi.core.errors import InputError, expecting


@dataclass(frozen=True)
class Rest:
    """A person in the T-pose, from :meth:`BodyModel.rest`.

    Example:
        >>> from gva_mi.body.pose import WRISTS
        >>> left, right = load_body().rest(Shape(torch.zeros(10))).joints[WRISTS]
        >>> print(f"{float(left[0] - right[0]):.2f} m")  # x points to the person's left
        1.41 m
    """

    vertices: Tensor  # (V, 3) metres
    joints: Tensor  # (55, 3) metres


@dataclass(frozen=True)
class Posed:
    """A person in T poses, in the world, from calling a :class:`BodyModel`.

    Example:
        >>> from gva_mi.body.pose import WRISTS
        >>> rotations = torch.zeros(1, 55, 3)
        >>> rotations[0, 0, 1] = torch.pi  # the root turns around: left and right change sides
        >>> pose = Pose(rotations, torch.zeros(1, 3), torch.zeros(1, 10))
        >>> posed = load_body()(pose, Shape(torch.zeros(10)))
        >>> left, right = posed.joints[0, WRISTS]
        >>> print(f"{float(left[0] - right[0]):.2f} m")
        -1.41 m
    """

    vertices: Tensor  # (T, V, 3) metres
    joints: Tensor  # (T, 55, 3) metres
    T_world_rest: Tensor  # (T, 55, 4, 4) from the rest pose to the world, per joint


class BodyModel(nn.Module):
    """A body in SMPL-X's format, ``body(pose, shape, offsets) -> Posed``.

    All numbers are buffers of one precision, which ``body.to(torch.float64)`` changes. It has no
    trainable parameters.

    Attributes:
        v_template: (V, 3) the mean person in the T-pose, metres.
        faces: (F, 3) int64, counter-clockwise seen from outside.
        weights: (V, 55) skinning weights.
        parents: 55 indices, -1 for the root.
        num_betas, num_expressions: of the file; missing coefficients count as zero.
        mark_corners, mark_shares: (51, 3) vertices, and their shares, of the landmarks of the face
            that a file of SMPL-X marks; None in others.

    Example:
        A taller person, one metre to the side.

        >>> body = load_body()
        >>> moved = Pose(torch.zeros(1, 55, 3), torch.tensor([[1.0, 0, 0]]), torch.zeros(1, 10))
        >>> posed = body(moved, Shape(torch.tensor([2.0])))  # the first coefficient: height
        >>> height = lambda x: float(x[:, 1].max() - x[:, 1].min())
        >>> print(f"{height(body.v_template):.2f} m, {height(posed.vertices[0]):.2f} m")
        1.77 m, 1.92 m
        >>> posed.joints[0, 0].round(decimals=2) + 0  # the pelvis
        tensor([1., 0., 0.])
    """

    parents: tuple[int, ...] = PARENTS

    def __init__(self, arrays: dict[str, np.ndarray], dtype: torch.dtype = torch.float32) -> None:
        """Build a body from the arrays of a file, checked by :func:`load_body`.

        ``shapedirs`` hold ``num_betas``, then ``num_expressions`` directions; at most 10 each if
        these numbers are missing.
        """
        super().__init__()
        # Copies: bodies may share the arrays.
        tensor = lambda array: torch.from_numpy(np.ascontiguousarray(array)).to(dtype, copy=True)
        directions = as_rows(arrays["shapedirs"])
        split = int(arrays.get("num_betas", 10))
        betas = slice(0, split)
        expressions = slice(split, split + int(arrays.get("num_expressions", 10)))
        self.register_buffer("v_template", tensor(arrays["v_template"]))
        self.register_buffer("faces", torch.from_numpy(arrays["f"].astype(np.int64)))
        self.register_buffer("weights", tensor(arrays["weights"]))
        self.register_buffer("shape_directions", tensor(directions[betas]))  # (B, W)
        # Joints are linear in the coefficients, so the directions are regressed once.
        regressor = arrays["J_regressor"].astype(np.float64)
        joints = regressor @ arrays["shapedirs"].reshape(len(arrays["v_template"]), -1)
        joints = joints.reshape(165, -1).T
        self.register_buffer("regressor", tensor(regressor))  # (55, V)
        self.register_buffer("j_template", tensor(regressor @ arrays["v_template"]))
        self.register_buffer("shape_joints", tensor(joints[betas]))  # (B, 165)
        self.register_buffer("expression_joints", tensor(joints[expressions]))  # (E, 165)
        used = np.flatnonzero(arrays["posedirs"].any((0, 1)))  # skips zero directions
        self.register_buffer("pose_features", torch.from_numpy(used))
        # All that changes per frame is one sum: pose directions, then expressions.
        bent = as_rows(arrays["posedirs"][..., used])
        both = tensor(np.concatenate([bent, directions[expressions]]))
        self.register_buffer("frame_directions", both)  # (P + E, W)
        marks = arrays.get("lmk_faces_idx")
        corners = None if marks is None else self.faces[torch.from_numpy(marks.astype(np.int64))]
        self.register_buffer("mark_corners", corners)
        shares = None if marks is None else tensor(arrays["lmk_bary_coords"])
        self.register_buffer("mark_shares", shares)

    @property
    def num_betas(self) -> int:
        return len(self.shape_directions)

    @property
    def num_expressions(self) -> int:
        return len(self.expression_directions)

    @property
    def expression_directions(self) -> Tensor:
        """Expression directions (E, W)."""
        return self.frame_directions[len(self.pose_features) :]

    def on(self, vertices: Tensor, faces: Tensor) -> BodyModel:
        """Return the body restricted to some vertices (n,), with the same joints.

        ``faces`` (F, 3) are triangles of these, numbered from 0 to n - 1.

        Example:
            >>> part = load_body().on(torch.arange(100), torch.tensor([[0, 1, 2]]))
            >>> part(Pose.rest(), Shape(torch.zeros(10))).vertices.shape
            torch.Size([1, 100, 3])
        """
        part = copy.copy(self)
        part._buffers = dict(self._buffers)  # the others are shared
        part.v_template, part.weights = self.v_template[vertices], self.weights[vertices]
        part.faces, part.regressor = faces, None  # joints need all vertices
        part.mark_corners = part.mark_shares = None
        for name in ("shape_directions", "frame_directions"):
            setattr(part, name, columns_of(getattr(self, name), vertices, len(self.v_template)))
        return part

    def arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays of a file of version 1.0 with ten betas and at most ten expressions.

        Example:
            >>> load_body().arrays()["shapedirs"].shape
            (10989, 3, 20)
        """
        if self.regressor is None:
            raise ValueError("BodyModel.arrays(): this is a part of a body, from BodyModel.on()")
        count = len(self.v_template)
        rows = lambda directions: as_directions(directions[:10].double().numpy(), count)
        betas = rows(self.shape_directions)
        betas = np.pad(betas, ((0, 0), (0, 0), (0, 10 - betas.shape[2])))
        bent = np.zeros((count, 3, 9 * (len(PARENTS) - 1)), np.float32)
        features = self.frame_directions[: len(self.pose_features)].numpy()
        bent[..., self.pose_features.numpy()] = as_directions(features, count)
        return {
            "v_template": self.v_template.numpy(),
            "f": self.faces.numpy(),
            "shapedirs": np.concatenate([betas, rows(self.expression_directions)], axis=2),
            "posedirs": bent,
            "J_regressor": self.regressor.numpy(),
            "weights": self.weights.numpy(),
            "kintree_table": kintree_table(),
            "hands_meanl": np.zeros(45),
            "hands_meanr": np.zeros(45),
        }

    def rest(self, shape: Shape, expression: Tensor | None = None) -> Rest:
        """Return the person in the T-pose (eq. 1, 2), with an expression (E,) or a neutral face.

        Example:
            >>> rest = load_body().rest(Shape(torch.zeros(10)))
            >>> rest.vertices.shape, rest.joints.shape
            (torch.Size([10989, 3]), torch.Size([55, 3]))
        """
        psi = shape.betas.new_zeros(1, 0) if expression is None else expression[None]
        psi = _coefficients("expression", psi, self.num_expressions)
        flat, joints = self._shaped(shape, psi, self.v_template)
        flat = add_directions(flat, psi, self.expression_directions)
        return Rest(flat[0].view(3, -1).mT.contiguous(), joints[0])

    def forward(self, pose: Pose, shape: Shape, offsets: Tensor | None = None) -> Posed:
        """Return the person in the world (eq. 1-4), differentiable in all arguments.

        Args:
            pose: T frames; the expression may have fewer coefficients than the file.
            shape: betas (B,), B up to ``num_betas``.
            offsets: (V, 3) added in the rest pose, metres.
        """
        if offsets is not None and offsets.shape != self.v_template.shape:
            expected, found = tuple(self.v_template.shape), tuple(offsets.shape)
            raise ValueError(f"BodyModel(): offsets must be {expected}, got {found}")
        template = self.v_template if offsets is None else self.v_template + offsets
        psi = _coefficients("expression", pose.expression, self.num_expressions)
        flat, joints = self._shaped(shape, psi, template)
        R, T_world_rest = turn_joints(pose.rotations, joints, self.parents, pose.transl)
        bent = (R[:, 1:] - torch.eye(3, dtype=R.dtype)).flatten(1)  # R - I (eq. 3)
        if len(self.pose_features) < bent.shape[1]:
            bent = bent[:, self.pose_features]
        moves = torch.cat([bent, psi], dim=1)
        flat = add_directions(flat, moves, self.frame_directions)
        skinned = skin_points(flat.unflatten(1, (3, -1)).mT, self.weights, T_world_rest)
        return Posed(skinned, joint_places(T_world_rest, joints), T_world_rest)

    def _shaped(self, shape: Shape, psi: Tensor, template: Tensor) -> tuple[Tensor, Tensor]:
        """Return rest vertices without expression (1, 3 V), and joints with it (T, 55, 3)."""
        betas = _coefficients("betas", shape.betas[None], self.num_betas)
        flat = add_directions(template.mT.reshape(1, -1), betas, self.shape_directions)
        joints = self.j_template.view(1, -1)
        for values, moves in ((betas, self.shape_joints), (psi, self.expression_joints)):
            joints = torch.addmm(joints, values, moves[: values.shape[1]])
        return flat, joints.unflatten(1, (-1, 3))


BUILT_IN_NAME = "built-in"  # the built-in body on the command line and in records


def load_body(path: Path | None = None, dtype: torch.dtype = torch.float32) -> BodyModel:
    """Read a body file, or the built-in body.

    Args:
        path: a file such as ``SMPLX_NEUTRAL.npz``, see :mod:`gva_mi.body.body_file`; None or
            ``built-in`` is the built-in body.
        dtype: float32 or float64.

    Raises:
        InputError: naming the file, the key, and the shape that was found.

    Example:
        >>> body = load_body(dtype=torch.float64)
        >>> body.num_betas, body.num_expressions, body.v_template.dtype
        (10, 10, torch.float64)
    """
    path = resolve_body(path)
    with expecting(path, "a body in SMPL-X's format"):
        return BodyModel(read_body(path), dtype)


def resolve_body(path: Path | None) -> Path:
    """Return the file that :func:`load_body` reads.

    Example:
        >>> resolve_body(None).name, resolve_body(Path("SMPLX_NEUTRAL.npz")).name
        ('built_in.npz', 'SMPLX_NEUTRAL.npz')
    """
    return BUILT_IN_BODY if path is None or str(path) == BUILT_IN_NAME else Path(path)


def body_name(path: Path | None) -> str:
    """Return a short name of the body that :func:`load_body` reads.

    Example:
        >>> body_name(None), body_name(Path("models/SMPLX_NEUTRAL.npz"))
        ('built-in', 'SMPLX_NEUTRAL')
    """
    return BUILT_IN_NAME if path is None else Path(path).stem


def _coefficients(name: str, values: Tensor, available: int) -> Tensor:
    """Cut coefficients (T, K) to those of the file; the others must be zero."""
    if values.shape[1] > available and bool((values[:, available:] != 0).any()):
        raise InputError(
            f"the pose or shape has {values.shape[1]} {name}, but the body file has {available}"
        )
    return values[:, :available]


def as_rows(directions: np.ndarray) -> np.ndarray:
    """Convert directions (V, 3, K) to rows (K, W): all x, then all y, then all z.

    W is 3 V, padded to be even.

    Example:
        >>> as_rows(np.ones((5, 3, 2))).shape
        (2, 16)
    """
    vertices, _, count = directions.shape
    rows = np.zeros((count, 3 * vertices + vertices % 2), directions.dtype)
    rows[:, : 3 * vertices] = directions.transpose(2, 1, 0).reshape(count, 3 * vertices)
    return rows


def as_directions(rows: np.ndarray, vertices: int) -> np.ndarray:
    """Convert rows (K, W) of :func:`as_rows` back to directions (V, 3, K).

    Example:
        >>> directions = np.arange(30).reshape(5, 3, 2)
        >>> bool((as_directions(as_rows(directions), 5) == directions).all())
        True
    """
    return rows[:, : 3 * vertices].reshape(len(rows), 3, vertices).transpose(2, 1, 0)


def columns_of(rows: Tensor, vertices: Tensor, count: int) -> Tensor:
    """Select ``vertices`` (n,) from rows (K, W) of ``count`` vertices.

    Example:
        >>> columns_of(torch.ones(2, 16), torch.tensor([0, 4]), count=5).shape
        torch.Size([2, 6])
    """
    chosen = rows[:, : 3 * count].unflatten(1, (3, count))[:, :, vertices].flatten(1)
    return pad(chosen, (0, chosen.shape[1] % 2))


def add_directions(surface: Tensor, coefficients: Tensor, directions: Tensor) -> Tensor:
    """Move a surface along directions (eq. 5).

    Args:
        surface: (1, 3 V) or (T, 3 V) metres, all x, then all y, then all z.
        coefficients: (T, K), K at most the number of directions; missing ones count as zero.
        directions: (K', W) from :func:`as_rows`.

    Returns:
        (T, 3 V), differentiable once in surface and coefficients.

    Example:
        One vertex and one direction, along y.

        >>> direction = torch.from_numpy(as_rows(np.array([[[0], [1], [0]]], np.float32)))
        >>> add_directions(torch.zeros(1, 3), torch.tensor([[0.5], [2.0]]), direction)
        tensor([[0.0000, 0.5000, 0.0000],
                [0.0000, 2.0000, 0.0000]])
    """
    return _AddDirections.apply(surface, coefficients, directions[: coefficients.shape[1]])


class _AddDirections(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: FunctionCtx, surface: Tensor, coefficients: Tensor, directions: Tensor
    ) -> Tensor:
        ctx.save_for_backward(coefficients, directions)
        ctx.save_for_forward(directions)
        ctx.shared = len(surface) < len(coefficients)
        return surface + _weighted(coefficients, directions)[:, : surface.shape[1]]

    @staticmethod
    def jvp(ctx: FunctionCtx, dsurface: Tensor, dcoefficients: Tensor, _: Tensor) -> Tensor:
        (directions,) = ctx.saved_tensors
        return dsurface + _weighted(dcoefficients, directions)[:, : dsurface.shape[1]]

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: FunctionCtx, grad: Tensor) -> tuple[Tensor, Tensor | None, None]:
        coefficients, directions = ctx.saved_tensors
        grad_coefficients = None
        if ctx.needs_input_grad[1]:
            even = pad(grad, (0, directions.shape[1] - grad.shape[1]))
            grad_coefficients = torch.bmm(_halves(even), _halves(directions).mT).sum(0)
        return grad.sum(0, keepdim=True) if ctx.shared else grad, grad_coefficients, None


def _weighted(coefficients: Tensor, directions: Tensor) -> Tensor:
    """Return the sum of eq. 5, (T, W)."""
    moved = torch.bmm(coefficients.expand(2, -1, -1), _halves(directions))
    return moved.transpose(0, 1).flatten(1)


def _halves(rows: Tensor) -> Tensor:
    """View rows (K, W) as (2, K, W / 2)."""
    return rows.unflatten(1, (2, -1)).transpose(0, 1)
