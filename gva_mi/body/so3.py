"""Rotations as torch tensors: axis-angle to matrices and back, and composition.

Composition has an exact derivative, with a formula of its own:

    1. c = log(exp(a) exp(b))

A small change of x rotates exp(x) from the right by its right Jacobian J, and a small rotation w
from the right changes x by the inverse of J:

    2. J(x) = I - B [x] + C [x]²,      J⁻¹(x) = I + ½ [x] + D [x]²,      θ = |x|
       B = (1 - cos θ) / θ²,   C = (θ - sin θ) / θ³,   D = (1 - ½ θ cot ½ θ) / θ²
    3. dc = J⁻¹(c) (J(b) db + exp(b)ᵀ J(a) da)

and the adjoint, for a gradient g of c:

    4. w = J⁻ᵀ(c) g,    grad_b = Jᵀ(b) w,    grad_a = Jᵀ(a) exp(b) w

Eq. 1 uses quaternions. Its derivative is written out because autograd's graph of some forty
operations takes three times as long, in every step of a fit and of a refinement.

Source: Solà, Deray and Atchuthan, "A micro Lie theory for state estimation in robotics", 2018,
appendix B (exp, log, right Jacobian and its inverse). The package roma has these functions too, but
importing it imports torch's compiler, which takes longer than importing torch. Tests compare both.
"""

from __future__ import annotations

import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx

from gva_mi.core.cpu import sqrt

# Below this θ², C and D take their limits, and below this θ, exp(x) ≈ I + [x]. Chosen: the terms
# that are left out, θ⁴/120 and θ²/2, are below 1e-12 there.
NEAR_IDENTITY = 1e-6


def to_matrix(x: Tensor) -> Tensor:
    """Return the rotation matrices exp(x), (..., 3, 3), of axis-angle vectors (..., 3), radians.

    Source: Rodrigues' formula, as in :mod:`gva_mi.body.kinematics`, eq. 1.

    Example:
        >>> to_matrix(torch.tensor([0, 0, torch.pi / 2])).round(decimals=3).abs()
        tensor([[0., 1., 0.],
                [1., 0., 0.],
                [0., 0., 1.]])
    """
    theta = torch.norm(x, dim=-1, keepdim=True)
    axis = x / theta.clamp_min(NEAR_IDENTITY)
    u, v, w = (axis * theta.sin()).unbind(-1)
    versine = (1 - theta.cos())[..., 0]
    a, b, c = axis.unbind(-1)
    aa, bb, cc = a**2 * versine, b**2 * versine, c**2 * versine
    ab, ac, bc = a * b * versine, a * c * versine, b * c * versine
    R = [1 - bb - cc, ab - w, ac + v, ab + w, 1 - aa - cc, bc - u, ac - v, bc + u, 1 - aa - bb]
    (u, v, w), one = x.unbind(-1), torch.ones_like(x[..., 0])
    first_order = torch.stack([one, -w, v, w, one, -u, -v, u, one], dim=-1)
    R = torch.where(theta < NEAR_IDENTITY, first_order, torch.stack(R, dim=-1))
    return R.unflatten(-1, (3, 3))


def to_rotvec(R: Tensor) -> Tensor:
    """Return axis-angle vectors (..., 3), at most half a turn, of rotation matrices (..., 3, 3).

    Each column of 4 q qᵀ is a multiple of the quaternion q; the longest has the most digits.
    Source: Markley, *Unit Quaternion from Rotation Matrix*, 2008.

    Example:
        >>> to_rotvec(to_matrix(torch.tensor([0.1, -0.2, 0.3])))
        tensor([ 0.1000, -0.2000,  0.3000])
    """
    (a, d, g), (b, e, h), (c, f, i) = (column.unbind(-1) for column in R.unbind(-1))
    columns = torch.stack(
        [1 + a - e - i, b + d, c + g, h - f,
         b + d, 1 + e - i - a, f + h, c - g,
         c + g, f + h, 1 + i - a - e, d - b,
         h - f, c - g, d - b, 1 + a + e + i], dim=-1
    ).unflatten(-1, (4, 4))  # fmt: skip
    longest = columns.diagonal(dim1=-2, dim2=-1).argmax(-1)[..., None, None]
    q = torch.take_along_dim(columns, longest, -2)[..., 0, :]
    q = q / torch.norm(q, dim=-1, keepdim=True)
    q = torch.where(q[..., 3:] > 0, q, -q)
    half = torch.atan2(torch.norm(q[..., :3], dim=-1, keepdim=True), q[..., 3:])
    return q[..., :3] * (2 * half / half.sin()).where(half > 0, 2.0)


def nearest(M: Tensor) -> Tensor:
    """Return the rotation matrices (..., 3, 3) nearest to matrices; not for gradients.

    Source: the orthogonal Procrustes problem, with the sign of Kabsch, "A solution for the best
    rotation to relate two sets of vectors", 1976.

    Example:
        >>> nearest(torch.diag(torch.tensor([2.0, 1, -0.5]))).diagonal()
        tensor([1., 1., 1.])
    """
    U, _, Vt = torch.linalg.svd(M)
    U[..., -1] *= (torch.det(U) * torch.det(Vt)).sign()[..., None]
    return U @ Vt


def turns_between(before: Tensor, after: Tensor) -> Tensor:
    """Return the turns ``log(Rᵀ R')`` (..., 3) between rotations ``R`` and ``R'``, axis-angle.

    This is ``compose(-before, after)`` in the precision of the arguments, with torch's derivatives.

    Example:
        >>> turns_between(torch.tensor([0.25, 0, 0]), torch.tensor([0.75, 0, 0]))
        tensor([0.5000, 0.0000, 0.0000])
    """
    p, q = torch.broadcast_tensors(_quaternion(-before), _quaternion(after))
    (u, w), (v, z) = p.split((3, 1), -1), q.split((3, 1), -1)
    real = w * z - (u * v).sum(-1, keepdim=True)
    turn = torch.cat([w * v + z * u + torch.linalg.cross(u, v), real], -1)
    turn = turn * torch.where(real > 0, 1, -1)
    half = torch.atan2(torch.norm(turn[..., :3], dim=-1, keepdim=True), turn[..., 3:])
    small = _is_small(half)
    series = 1 + half**2 / 6 + 7 * half**4 / 360
    return 2 * torch.where(small, series, half / half.sin().where(~small, 1)) * turn[..., :3]


def _quaternion(x: Tensor) -> Tensor:
    """Return the quaternion (..., 4) of an axis-angle (..., 3), with the real part last."""
    half = torch.norm(x, dim=-1, keepdim=True) / 2
    small = _is_small(half)
    series = 1 - half**2 / 6 + half**4 / 120
    scale = torch.where(small, series, half.sin() / half.where(~small, 1)) / 2
    return torch.cat([scale * x, half.cos()], -1)


def _is_small(half: Tensor) -> Tensor:
    """Return where the series of (sin x) / x has a more exact derivative than the quotient.

    The series lacks a share x⁴ of it, the quotient ε / x²: as roma, the limit is their crossing.
    """
    return half < 2 * torch.finfo(half.dtype).eps ** (1 / 6)


def compose(a: Tensor, b: Tensor) -> Tensor:
    """Rotate by ``b``, then ``a`` (eq. 1), both (..., 3) radians; has adjoint and tangent.

    Example:
        Two turns about one axis add up.

        >>> compose(torch.tensor([0.5, 0, 0]), torch.tensor([0.25, 0, 0]))
        tensor([0.7500, 0.0000, 0.0000])
    """
    return _Compose.apply(*torch.broadcast_tensors(a, b))


class _Compose(torch.autograd.Function):
    @staticmethod
    def forward(ctx: FunctionCtx, a: Tensor, b: Tensor) -> Tensor:
        c = _composed(a.double(), b.double()).to(a)
        ctx.save_for_backward(a, b, c)
        ctx.save_for_forward(a, b, c)
        return c

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: FunctionCtx, grad: Tensor) -> tuple[Tensor | None, Tensor | None]:
        a, b, c = (x.double() for x in ctx.saved_tensors)
        w = _inverse(-c, grad.double())
        of_a, of_b = ctx.needs_input_grad
        by_a = _jacobian(-a, _turned(b, w)).to(grad) if of_a else None
        return by_a, _jacobian(-b, w).to(grad) if of_b else None

    @staticmethod
    def jvp(ctx: FunctionCtx, da: Tensor, db: Tensor) -> Tensor:
        a, b, c = (x.double() for x in ctx.saved_tensors)
        turn = _jacobian(b, db.double()) + _turned(-b, _jacobian(a, da.double()))
        return _inverse(c, turn).to(db)


def _composed(a: Tensor, b: Tensor) -> Tensor:
    """Evaluate eq. 1; the result is at most half a turn."""
    (w, u), (z, v) = to_quaternion(a), to_quaternion(b)
    real = w * z - (u * v).sum(-1, keepdim=True)
    rest = w * v + z * u + torch.linalg.cross(u, v)
    rest, real = torch.where(real < 0, -rest, rest), real.abs()
    sine = sqrt(rest.square().sum(-1, keepdim=True))
    angle = 2 * torch.atan2(sine, real)
    return rest * torch.where(sine > 0, angle / sine, 2)


def to_quaternion(x: Tensor) -> tuple[Tensor, Tensor]:
    """Return the quaternion of an axis-angle as real part (..., 1) and vector (..., 3).

    Example:
        >>> real, vector = to_quaternion(torch.tensor([torch.pi / 2, 0, 0]))
        >>> real, vector
        (tensor([0.7071]), tensor([0.7071, 0.0000, 0.0000]))
    """
    theta = sqrt(x.square().sum(-1, keepdim=True))
    return (theta / 2).cos(), x * (torch.sinc(theta / (2 * torch.pi)) / 2)


def _jacobian(x: Tensor, v: Tensor) -> Tensor:
    """Return J(x) v; for -x it is Jᵀ(x) v."""
    square = x.square().sum(-1, keepdim=True)
    theta = sqrt(square)
    B = torch.sinc(theta / (2 * torch.pi)).square() / 2
    C = torch.where(square > NEAR_IDENTITY, (1 - torch.sinc(theta / torch.pi)) / square, 1 / 6)
    across = torch.linalg.cross(x, v)
    return v - B * across + C * torch.linalg.cross(x, across)


def _inverse(x: Tensor, v: Tensor) -> Tensor:
    """Return J⁻¹(x) v; for -x it is J⁻ᵀ(x) v."""
    square = x.square().sum(-1, keepdim=True)
    half = sqrt(square) / 2
    D = torch.where(square > NEAR_IDENTITY, (1 - half / half.tan()) / square, 1 / 12)
    across = torch.linalg.cross(x, v)
    return v + across / 2 + D * torch.linalg.cross(x, across)


def _turned(x: Tensor, v: Tensor) -> Tensor:
    """Return exp(x) v."""
    square = x.square().sum(-1, keepdim=True)
    theta = sqrt(square)
    B = torch.sinc(theta / (2 * torch.pi)).square() / 2
    across = torch.linalg.cross(x, v)
    return v + torch.sinc(theta / torch.pi) * across + B * torch.linalg.cross(x, across)
