"""Skin Gaussians by linear blend skinning: transforms, stretch and light as one kernel each way.

Between two joints that turn differently, skin is pulled apart. The LBS transform A moves a point;
the derivative of x' = A(x) x moves its surroundings. Beside A_rot it has a part E, by which A
itself changes from place to place:

    1. A, E  a Gaussian's LBS transform and its derivative        gva_mi.avatar.lbs_transforms
    2. J  = A_rot + β E,   β = (1 + |E|² / LARGEST²)^(-1/2)       as much as cloth bears
    3. F  = J M S,   Σ' = F Fᵀ                                    M, S: the Gaussian at rest
    4. μ' = A_rot μ + A_trans                                     Eq. 5

Eq. 6 of the paper turns a Gaussian by A_rot and keeps its size: where a wide step spreads a skirt,
Gaussians come apart and show what is behind them. With eq. 3 they grow and shear as the cloth
does. A rigid motion has no E and moves Gaussians exactly.

Colours depend on the direction of the light, for red, green and blue:

    5. t_k = Σ_i A_ik l_i                         A_rotᵀ l: the light, seen from the rest pose
    6. f   = f_0 + Σ_k t_k f_k                    a Gaussian's colour

The light l has a direction; its length is always LIGHT_LENGTH, so that slopes are learned more
slowly than f_0, like the higher bands in 3D Gaussian splatting. Otherwise details that hardly
depend on light while a person turns upright, such as the pattern of a cloth, would be learned half
as slopes and be wrong once an arm is raised. Near a bent joint the blend A_rot is no rotation and
shortens the slopes, which is harmless.

The adjoint, for gradients g of μ', G of Σ' (symmetric) and h of f:

    7. grad_F = 2 G F,   grad_S, grad_M, grad_J by F = J M S
    8. grad_E = β grad_J - (β³ / LARGEST²) (grad_J : E) E
    9. grad_A = [grad_J + g μᵀ | g],   grad_μ = A_rotᵀ g
    10. grad_f_0 = h,    grad_f_k = t_k h
    11. grad_t_k = f_k · h,    grad_A_ik = l_i grad_t_k,    grad_l_i = Σ_n Σ_k A_ik grad_t_k

Separate kernels would move 33 numbers per Gaussian to memory and back, which takes longer than
computing them. The backward pass reads the A and E that the forward pass kept. It writes rows of 24
numbers, [grad_A | grad_E | μ], from which the gradients of the joints' transforms are summed.
Tangents, which no fit needs, come from :mod:`gva_mi.avatar.lbs_reference`.

Sources: eq. 3 deforms a Gaussian by the linear part of a map, as in EWA splatting (Zwicker et al.,
2001) and PhysGaussian (Xie et al., 2024); eq. 2 and 5-11 are ours.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import drjit as dr
import torch
from drjit import ArrayBase as Array
from torch import Tensor
from torch.autograd.function import FunctionCtx
from torch.nn.functional import pad

from gva_mi.avatar import lbs_reference, lbs_transforms
from gva_mi.avatar.lbs_transforms import AXES, MAX_STRETCH, PairLists, SparseWeights
from gva_mi.jit.frozen import Frozen, exclusive
from gva_mi.jit.rowwise import Lane, flat_array, load_columns, store_columns, to_tensors
from gva_mi.splat.kernels.ellipse import Rotation
from gva_mi.splat.kernels.vectors import Mat3, Quat

WIDTHS = (3, 4, 3, 12)  # widths of rows of means, quats, scales and colours
PAIRS = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]  # of a covariance's six numbers
LIGHT_LENGTH = 0.3  # |l|, no unit; chosen: slopes are learned at a third of the rate of f_0


def skin_gaussians(
    weights: SparseWeights,
    T_world_rest: Tensor,
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    sh: Tensor,
    light: Tensor,
) -> tuple[Tensor, Tensor, Tensor]:
    """Move N Gaussians from the rest pose into the world.

    Args:
        weights: skinning weights of the Gaussians.
        T_world_rest: (J, 4, 4) float64, the joints' transforms.
        means: (N, 3) metres, at rest.
        quats: (N, 4) wxyz, of any length.
        scales: (N, 3) metres.
        sh: (N, K, 3), K = 1 or 4: constant colours, and slopes along the axes of the rest pose.
        light: (3,) direction that the light comes from, in the world, of any length.

    Returns:
        Means (N, 3), covariances (N, 6) as xx, xy, xz, yy, yz, zz, and colours (N, 1, 3).
        Differentiable in all tensors, both ways.

    Example:
        Two joints move apart along x, and the Gaussian between them grows along x.

        >>> W, slopes = torch.full((1, 2), 0.5), torch.zeros(1, 3, 2)
        >>> slopes[0, 0] = torch.tensor([-1.0, 1.0])  # 1/m, along x
        >>> T = torch.eye(4, dtype=torch.float64).repeat(2, 1, 1)
        >>> T[1, 0, 3] = 1  # the second joint: 1 m along x
        >>> means, covars, colors = skin_gaussians(
        ...     SparseWeights.of(W, slopes), T, torch.zeros(1, 3), torch.tensor([[1.0, 0, 0, 0]]),
        ...     torch.full((1, 3), 0.1), torch.zeros(1, 1, 3), torch.tensor([0.0, 1, 0]),
        ... )
        >>> means, covars.sqrt().round(decimals=3)
        (tensor([[0.5000, 0.0000, 0.0000]]),
         tensor([[0.1950, 0.0000, 0.0000, 0.1000, 0.0000, 0.1000]]))
    """
    T, direction = T_world_rest[:, :3].flatten(1), light_vector(light)
    coefficients = sh.flatten(1)
    if sh.shape[1] == 1:  # pad() copies even where it adds nothing
        coefficients = pad(coefficients, (0, WIDTHS[3] - 3))
    given = T, means, quats, scales, coefficients, direction
    moved, covars, colors = _Skinned.apply(*given, weights)
    return moved, covars, colors.unsqueeze(1)


def _bound(E: Lane) -> Any:  # noqa: ANN401
    """Return β of eq. 2."""
    return 1 / dr.sqrt(1 + _dot(E, E) / MAX_STRETCH**2)


def _jacobian(A: Lane, E: Lane, beta: Any) -> Lane:  # noqa: ANN401
    """Return J of eq. 2."""
    return [A[4 * i + c] + beta * E[3 * i + c] for i in AXES for c in AXES]


def _times(X: Lane, Y: Lane) -> Lane:
    """Multiply two matrices."""
    return [sum(X[3 * i + k] * Y[3 * k + j] for k in AXES) for i in AXES for j in AXES]


def _transposed(X: Lane) -> Lane:
    return [X[3 * j + i] for i in AXES for j in AXES]


def _scaled(X: Lane, scale: Lane) -> Lane:
    """Multiply a matrix by a diagonal one."""
    return [X[3 * i + j] * scale[j] for i in AXES for j in AXES]


def _dot(X: Lane, Y: Lane) -> Any:  # noqa: ANN401
    return sum(a * b for a, b in zip(X, Y, strict=True))


def stretch(A: Lane, E: Lane, mean: Lane, quat: Lane, scale: Lane) -> tuple[Lane, Lane]:
    """Evaluate eq. 2 to 4: μ', and the six numbers of Σ' (xx, xy, xz, yy, yz, zz).

    Example:
        Kernel functions work on plain numbers, too: a Gaussian that is moved by 2 along x.

        >>> A = [1, 0, 0, 2, 0, 1, 0, 0, 0, 0, 1, 0]
        >>> stretch(A, [0.0] * 9, [0, 0, 0], [1.0, 0.0, 0.0, 0.0], [1, 2, 3])
        ([2, 0, 0], [1.0, 0.0, 0.0, 4.0, 0.0, 9.0])
    """
    JM = _times(_jacobian(A, E, _bound(E)), Rotation.of(Quat(*quat)).M.flat())
    F = _scaled(JM, scale)
    moved = [sum(A[4 * i + k] * mean[k] for k in AXES) + A[4 * i + 3] for i in AXES]
    return moved, [sum(F[3 * i + k] * F[3 * j + k] for k in AXES) for i, j in PAIRS]


def stretch_adjoint(
    A: Lane, E: Lane, mean: Lane, quat: Lane, scale: Lane, g: Lane, G: Lane
) -> tuple[Lane, Lane, Lane, Lane, Lane]:
    """Evaluate eq. 7 to 9: gradients of A, E, mean, quaternion and scale.

    Example:
        >>> A = [1, 0, 0, 2, 0, 1, 0, 0, 0, 0, 1, 0]
        >>> at = A, [0.0] * 9, [0, 0, 0], [1.0, 0.0, 0.0, 0.0], [1, 2, 3]
        >>> *_, grad_scale = stretch_adjoint(*at, g=[0, 0, 0], G=[1, 0, 0, 1, 0, 1])
        >>> grad_scale  # of s², s = 1, 2, 3
        [2.0, 4.0, 6.0]
    """
    rotation, beta = Rotation.of(Quat(*quat)), _bound(E)
    J, M = _jacobian(A, E, beta), rotation.M.flat()
    JM = _times(J, M)
    xx, xy, xz, yy, yz, zz = G  # a number beside the diagonal stands for two of a matrix
    twice = [2 * xx, xy, xz, xy, 2 * yy, yz, xz, yz, 2 * zz]
    grad_F = _times(twice, _scaled(JM, scale))
    grad_scale = [sum(grad_F[3 * i + j] * JM[3 * i + j] for i in AXES) for j in AXES]
    grad_JM = _scaled(grad_F, scale)
    grad_J, grad_M = _times(grad_JM, _transposed(M)), _times(_transposed(J), grad_JM)
    along = beta * beta * beta / MAX_STRETCH**2 * _dot(grad_J, E)
    grad_E = [beta * a - along * b for a, b in zip(grad_J, E, strict=True)]
    grad_A = []
    for i in AXES:
        grad_A += [grad_J[3 * i + k] + g[i] * mean[k] for k in AXES] + [g[i]]
    grad_mean = [sum(A[4 * i + k] * g[i] for i in AXES) for k in AXES]
    return grad_A, grad_E, grad_mean, list(rotation.adjoint(Mat3.of(grad_M))), grad_scale


def light_vector(light: Tensor) -> Tensor:
    """Return l (1, 3) of length LIGHT_LENGTH, from a direction (3,) of any length.

    Example:
        >>> light_vector(torch.tensor([0.0, 5, 0]))
        tensor([[0.0000, 0.3000, 0.0000]])
    """
    return LIGHT_LENGTH * torch.nn.functional.normalize(light, dim=0).unsqueeze(0)


def _light_at_rest(A: Lane, light: Lane) -> Lane:
    """Evaluate eq. 5."""
    return [sum(A[4 * i + k] * light[i] for i in AXES) for k in AXES]


def lit_color(A: Lane, sh: Lane, light: Lane) -> Lane:
    """Evaluate eq. 5 and 6: the colour of a Gaussian.

    Example:
        >>> A = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]
        >>> sh = [0.5, 0.5, 0.5, 0.1, 0.1, 0.1, 0, 0, 0, 0, 0, 0]  # brighter toward +x
        >>> lit_color(A, sh, light=[1, 0, 0])
        [0.6, 0.6, 0.6]
    """
    t = _light_at_rest(A, light)
    return [sh[c] + sum(t[k] * sh[3 * (1 + k) + c] for k in AXES) for c in AXES]


def lit_color_adjoint(A: Lane, sh: Lane, light: Lane, g: Lane) -> tuple[Lane, Lane, Lane]:
    """Evaluate eq. 10 and 11: gradients of sh, A and the light.

    Example:
        >>> A = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0]
        >>> grad_sh, _, _ = lit_color_adjoint(A, [0] * 12, light=[1, 0, 0], g=[1, 2, 3])
        >>> grad_sh
        [1, 2, 3, 1, 2, 3, 0, 0, 0, 0, 0, 0]
    """
    t = _light_at_rest(A, light)
    grad_sh = [*g, *(t[k] * g[c] for k in AXES for c in AXES)]
    grad_t = [sum(sh[3 * (1 + k) + c] * g[c] for c in AXES) for k in AXES]
    grad_A = []
    for i in AXES:
        grad_A += [light[i] * grad_t[k] for k in AXES] + [0 * light[i]]
    grad_light = [sum(A[4 * i + k] * grad_t[k] for k in AXES) for i in AXES]
    return grad_sh, grad_A, grad_light


@Frozen
def _forward(
    pairs: PairLists, T: Array, parts: list[Array], light: Array, *, n: int
) -> list[Array]:
    F = type(parts[0])
    mean, quat, scale, sh, l = _read_rows(parts, light, n)
    A, E = ([F(x) for x in columns] for columns in lbs_transforms.forward(pairs, T, mean))
    moved, covars = stretch(A, E, mean, quat, scale)
    color = lit_color(A, sh, l)
    kept = [*A, *E]
    found = [store_columns(columns, n, F) for columns in (moved, covars, color)]
    dr.eval(found, kept)
    return found + kept


@Frozen
def _adjoint(
    pairs: PairLists,
    T: Array,
    parts: list[Array],
    light: Array,
    kept: list[Array],
    grads: list[Array],
    *,
    n: int,
) -> list[Array]:
    """Return rows of the gradients of ``parts`` and the light, and of [grad_A | grad_E | μ]."""
    F = type(parts[0])
    mean, quat, scale, sh, l = _read_rows(parts, light, n)
    A, E, lane = kept[:12], kept[12:], dr.arange(dr.uint32_array_t(F), n)
    widths = zip(grads, (3, 6, 3), strict=True)
    g, G, g_color = (load_columns(x, width, lane) for x, width in widths)
    by_stretch = stretch_adjoint(A, E, mean, quat, scale, g, G)
    grad_A, grad_E, grad_mean, grad_quat, grad_scale = by_stretch
    grad_sh, grad_A_lit, grad_light = lit_color_adjoint(A, sh, l, g_color)
    grad_A = [a + b for a, b in zip(grad_A, grad_A_lit, strict=True)]
    by_E = lbs_transforms.adjoint_of_means(pairs, T, grad_E)
    grad_mean = [a + b for a, b in zip(grad_mean, by_E, strict=True)]
    columns = grad_mean, grad_quat, grad_scale, grad_sh, grad_light, [*grad_A, *grad_E, *mean]
    found = [store_columns(gradient, n, F) for gradient in columns]
    dr.eval(found)
    return found


@Frozen
def _adjoint_of_joints(pieces: PairLists, rows: Array, *, n: int) -> list[Array]:
    """Return the sums of each piece."""

    def of(gaussian: Array) -> tuple[Lane, Lane, Lane]:
        row = load_columns(rows, 24, gaussian)
        return row[:12], row[12:21], row[21:]

    sums = lbs_transforms.adjoint_of_joints(pieces, of)
    found = [store_columns(sums, n, type(sums[0]))]
    dr.eval(found)
    return found


def _read_rows(parts: list[Array], light: Array, n: int) -> list[Lane]:
    """Read each lane's own rows, and the light, which all lanes share."""
    lane = dr.arange(dr.uint32_array_t(type(light)), n)
    rows = [load_columns(part, width, lane) for part, width in zip(parts, WIDTHS, strict=True)]
    return [*rows, load_columns(light, 3, lane * 0)]


class _Skinned(torch.autograd.Function):
    """Autograd function of T (J, 12) float64, means, quats, scales, sh (N, 12), light (1, 3)."""

    @staticmethod
    @exclusive
    def forward(
        ctx: FunctionCtx,
        T: Tensor,
        means: Tensor,
        quats: Tensor,
        scales: Tensor,
        sh: Tensor,
        light: Tensor,
        weights: SparseWeights,
    ) -> tuple[Tensor, ...]:
        given, n = (T, means, quats, scales, sh, light), len(means)
        ctx.weights = weights
        ctx.save_for_backward(*given)
        ctx.save_for_forward(*given)
        if not n:
            return means.clone(), means.new_zeros(0, 6), means.clone()
        numbers = [flat_array(part) for part in (means, quats, scales, sh)]
        found = _forward(weights.of_gaussians, flat_array(T), numbers, flat_array(light), n=n)
        ctx.kept = found[3:]
        return to_tensors(found[:3], n)

    @staticmethod
    @torch.autograd.function.once_differentiable
    @exclusive
    def backward(ctx: FunctionCtx, *grads: Tensor) -> tuple[Tensor | None, ...]:
        T, means, quats, scales, sh, light = ctx.saved_tensors
        n, weights = len(means), ctx.weights
        if not n:
            return *(torch.zeros_like(x) for x in ctx.saved_tensors), None
        numbers = [flat_array(part) for part in (means, quats, scales, sh)]
        given = weights.of_gaussians, flat_array(T.to(means)), numbers, flat_array(light)
        *by_parts, by_light, rows = _adjoint(*given, ctx.kept, [flat_array(g) for g in grads], n=n)
        by_T = None
        if ctx.needs_input_grad[0]:
            (sums,) = _adjoint_of_joints(weights.of_pieces, rows, n=len(weights.piece_joints))
            by_T = lbs_transforms.add_pieces(weights, sums, T)
        *by_parts, by_light = to_tensors([*by_parts, by_light], n)
        return by_T, *by_parts, by_light.sum(0, keepdim=True), None

    @staticmethod
    def jvp(ctx: FunctionCtx, *tangents: Any) -> tuple[Tensor, ...]:  # noqa: ANN401
        function = partial(lbs_reference.skinned, ctx.weights)
        return torch.autograd.functional.jvp(function, ctx.saved_tensors, tangents[:-1])[1]
