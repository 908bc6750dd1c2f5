"""The Gaussian-process prior of corrections: errors of stage 1, and inertia of the motion.

Stage 1 gives ``y_k``; the true value is ``x_k = y_k + δ_k``. The error model
(:mod:`gva_mi.prior.error_model`) and the motion model (eq. 5) give the corrections ``δ`` of one
joint, or of one coordinate of a position, the energy (a negative log probability)

1. ``E(δ) = 1/2 Σ_kl δ_k · P_kl δ_l + Σ_k cost(Δ_k)``,   ``P = K⁻¹``,   ``Δ_k = m_k + δ_k+1 - δ_k``

with ``m_k = y_k+1 - y_k``; for a joint ``log(R_kᵀ R_k+1)``, in its own axes. Its curvature at ``δ``
is close to

2. ``H = P + Dᵀ W D``,    ``D δ = (δ_k+1 - δ_k)``,   ``W`` the stiffness of each step

So its minimum, the MAP estimate without any image, is found by solving ``H δ = -Dᵀ W m`` several
times, each time with updated ``W`` and outlier factors ``f`` of the errors.

``H`` also gives the coordinates ``u`` in which an optimiser should move ``δ``:

3. ``δ = M u``,    ``M = min(H⁻¹ / h, 1)^(1/2)``,    ``h`` the mean variance, by eigenvalues

The preconditioner ``M`` makes large steps of slow errors, and small steps of improbable ones, such
as a tremor (in the spirit of Nicolet et al., *Large Steps in Inverse Rendering*, 2021).

**Motion.** From one frame to the next a joint turns by ``Δ_k``. Most joints rest most of the time;
then one moves for a while, slowly or fast. So the speed ``s_k`` is estimated around every frame:

4. ``s_k² = mean over the frames around of |e_l|² / d``,   ``e_l = (Δ_l + ... + Δ_l+h-1) / √h``

This is the speed of a random walk that gets as far in ``h`` frames; the sum suppresses remaining
errors. The speed is estimated twice. From stage 1 a median is used, which ignores outliers, and
several ``h``, because slow motions exceed white errors over many frames only. From corrected poses
the coordinate that images show is used; motion in depth is assumed to be as fast as sideways.

A known estimator that smooths its poses has neither outliers nor white errors. Its ``s_k²`` is the
mean over the frames of stage 1, and is not updated. A median would take a short gesture for an
outlier, and a prior that has flattened the gesture would find it slow.

Given ``s_k``, motions follow Student's t distribution, so a single jump costs the logarithm of its
size, and not its square:

5. ``E = Σ_k (ν + d) / 2 · log(1 + |Δ_k|² / (ν s_k²))``

The pelvis may turn and travel steadily: there ``Δ`` is the change of its steps, ``Δ_k+1 - Δ_k``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx

from gva_mi.core.cpu import sqrt
from gva_mi.prior.error_model import (
    STUDENT_DOF,
    Stage1ErrorModel,
    covariance,
    median_of_square,
    outlier_factors,
)

MAP_ROUNDS = 8  # solves of eq. 2; chosen: half of them before any step may count as a jump
SPEED_FLOOR = 0.02  # least speed of a joint in a frame, relative to its error; chosen: not zero
EXCURSION_FRAMES = 8  # h of corrected poses; chosen by eye
STAGE1_EXCURSION_FRAMES = (4, 8, 16)  # h of stage 1, the largest result counts; chosen by eye
WINDOW_FRAMES = 4.0  # standard deviation of the Gaussian window of the mean in eq. 4; chosen by eye
SPEED_MEDIAN_FRAMES = 10  # frames to each side, of the running median of speeds; by eye


def excursions(changes: Tensor, span: int) -> Tensor:
    """Return ``e`` (n, ...) of changes ``Δ`` (n, ...), centred; the ends sum fewer frames."""
    total = torch.cat([torch.zeros_like(changes[:1]), changes.cumsum(0)])
    n = len(changes)
    first = (torch.arange(n) - span // 2).clamp(0, max(n - span, 0))
    last = (first + span).clamp(max=n)
    frames = (last - first).view(-1, *[1] * (changes.ndim - 1))
    return (total[last] - total[first]) / sqrt(frames)


def median_square_speed(e: Tensor) -> Tensor:
    """Return ``s²`` (n, C) of eq. 4 by a median, of excursions (n, C, d) with outliers."""
    square = e.square().sum(-1) / median_of_square(e.shape[-1])
    around = [
        square[max(0, k - SPEED_MEDIAN_FRAMES) : k + SPEED_MEDIAN_FRAMES + 1].median(0).values
        for k in range(len(square))
    ]
    return torch.stack(around) if around else square


def mean_square_speed(changes: Tensor, times: Tensor) -> Tensor:
    """Return ``s²`` (n, C) of eq. 4 by a mean, of changes (n, C, ...) at times (n,)."""
    return mean_square(excursions(changes, EXCURSION_FRAMES).square().mean(-1), times.float())


def mean_square(square: Tensor, times: Tensor) -> Tensor:
    """Return the windowed means (n, C) of squares (n, C) at times (n,)."""
    apart = (times[:, None] - times) / WINDOW_FRAMES
    weights = torch.exp(-apart.square() / 2)
    return (weights / weights.sum(1, keepdim=True)) @ square


def step_cost(changes: Tensor, square_speed: Tensor) -> Tensor:
    """Return the summands (...) of eq. 5 for ``Δ`` (..., d) and ``s²`` (...), nats."""
    x = changes.square().sum(-1) / (STUDENT_DOF * square_speed)
    return (STUDENT_DOF + changes.shape[-1]) / 2 * torch.log1p(x)


def step_stiffness(changes: Tensor, square_speed: Tensor) -> Tensor:
    """Return the weight ``w`` with which ``w |Δ|² / 2`` has the slope of eq. 5 at ``Δ``."""
    x = changes.square().sum(-1) / (STUDENT_DOF * square_speed)
    return (STUDENT_DOF + changes.shape[-1]) / (STUDENT_DOF * square_speed * (1 + x))


@dataclass(frozen=True)
class ProcessPrior:
    """The process of C joints or coordinates of a position in n frames, each a vector of d.

    Attributes:
        times: (n,) frame numbers.
        steps: (n - 1, C, d) ``m``; if steady, its changes (n - 2, C, d).
        error_models: C of them.
        factors: (C, n) ``f``, outlier factors.
        growth: (C, n) ``g``, growth of errors in motion.
        square_speed: (n - 1 or n - 2, C) ``s²`` of each step.
        steady: whether constant speed is as probable as rest.
    """

    times: Tensor
    steps: Tensor
    error_models: Sequence[Stage1ErrorModel]
    factors: Tensor
    growth: Tensor
    square_speed: Tensor
    steady: bool

    @staticmethod
    def of_stage1(
        times: Tensor, steps: Tensor, error_models: Sequence[Stage1ErrorModel], steady: bool = False
    ) -> ProcessPrior:
        """Estimate the speeds from steps (n - 1, C, d) between the n frames of stage 1 alone."""
        factors = torch.ones(steps.shape[1], len(times))
        each = zip(error_models, steps.unbind(1), strict=True)
        growth = torch.stack([x.growth(moved, times) for x, moved in each])
        process = ProcessPrior(times, steps, error_models, factors, growth, steps[..., 0], steady)
        process = replace(process, steps=process.changes(steps))
        white = torch.tensor([x.white for x in error_models]).square()
        of_white = 4 if steady else 2  # the variance of a change, for white errors of variance 1
        seen = [
            median_square_speed(excursions(process.steps, span)) - of_white * white / span
            for span in STAGE1_EXCURSION_FRAMES
        ]
        usual = torch.stack(seen).amax(0).clamp(min=0)
        mean = mean_square_speed(process.steps, times[: len(usual)])
        return process.with_speeds(torch.where(process.known, mean, usual))

    @property
    def known(self) -> Tensor:
        """Whether each error model (C,) is known for the estimator."""
        return torch.tensor([x.known for x in self.error_models])

    def changes(self, steps: Tensor) -> Tensor:
        """Return ``Δ`` of steps (n - 1, ...): the steps, or if steady their differences."""
        if not self.steady:
            return steps
        gaps = self.times.diff().to(steps.dtype).view(-1, *[1] * (steps.ndim - 1))
        return (steps / gaps).diff(dim=0)

    def with_speeds(self, square_speed: Tensor) -> ProcessPrior:
        """Return the process with other speeds, one for each step."""
        sizes = torch.tensor([x.size for x in self.error_models])
        return replace(self, square_speed=square_speed + (SPEED_FLOOR * sizes).square())

    def with_less_lag(self, shares: Tensor) -> ProcessPrior:
        """Return the process whose lag (eq. 5 of the error model) is multiplied by shares (n,)."""
        return replace(self, growth=sqrt(1 + shares.square() * (self.growth.square() - 1)))

    def with_outlier_factors(self, corrections: Tensor) -> ProcessPrior:
        """Return the process with the outlier factors of corrections (n, C, d)."""
        K, errors = self._error_covariance(), -corrections.transpose(0, 1)
        return replace(self, factors=outlier_factors(errors, K, self.error_models, self.factors))

    def map_estimate(self) -> tuple[Tensor, ProcessPrior]:
        """Return the MAP corrections (n, C, d), and the process with their outlier factors."""
        process, D = self, self._difference.double()
        corrections = torch.zeros(len(self.times), *self.steps.shape[1:])
        for k in range(MAP_ROUNDS):
            # No step counts as a jump at first, however large: otherwise nothing would move.
            H, W = process._curvature(corrections, jumps=k >= MAP_ROUNDS // 2)
            pull = torch.einsum("pk,cp,pcd->ckd", D, W, self.steps.double())
            solved = torch.cholesky_solve(-pull, torch.linalg.cholesky(H))
            corrections = solved.transpose(0, 1).float()
            process = process.with_outlier_factors(corrections)
        return corrections, process

    def energy(self, precision: FrameMatrices, corrections: Tensor, in_step_axes: Tensor) -> Tensor:
        """Return eq. 1.

        Args:
            precision: ``P`` (C, n, n).
            corrections: (n, C, d) in axes in which stage 1's errors last, such as the camera's.
            in_step_axes: the same in the axes of ``steps``.
        """
        e = corrections.transpose(0, 1)
        moved = step_cost(self._changes_under(in_step_axes), self.square_speed)
        return (e * (precision @ e)).sum() / 2 + moved.sum()

    def variance_of_mean(self, bias: bool) -> Tensor:
        """Return the variance (C,) of stage 1's mean error, with or without its bias."""
        return self._variances_of_mean[0 if bias else 1]

    @cached_property
    def _variances_of_mean(self) -> tuple[Tensor, Tensor]:
        """With and without the bias, each (C,); cached, because every step uses them."""
        K = self._error_covariance().mean((1, 2))
        without = torch.tensor([x.constant**2 for x in self.error_models])
        return K.float(), (K - without).float()

    def precision(self) -> FrameMatrices:
        """Return ``P`` (C, n, n)."""
        return FrameMatrices.of(self._precision().float())

    def covariance(self, corrections: Tensor) -> Tensor:
        """Return ``H⁻¹`` (C, n, n) float64 of one coordinate, at corrections (n, C, d)."""
        return torch.cholesky_inverse(torch.linalg.cholesky(self._curvature(corrections)[0]))

    def preconditioner(self, corrections: Tensor) -> FrameMatrices:
        """Return ``M`` (C, n, n) of eq. 3 at corrections (n, C, d)."""
        values, vectors = torch.linalg.eigh(self._curvature(corrections)[0])
        gain = sqrt((1 / values / (1 / values).mean(1, keepdim=True)).clamp(max=1))
        return FrameMatrices.of(((vectors * gain[:, None]) @ vectors.mT).float())

    def _curvature(self, corrections: Tensor, jumps: bool = True) -> tuple[Tensor, Tensor]:
        """Return ``H`` (C, n, n) and the diagonal of ``W`` (C, n - 1 or n - 2), float64."""
        D, changes = self._difference, self._changes_under(corrections)
        W = step_stiffness(changes if jumps else 0 * changes, self.square_speed).double().T
        D = D.double()
        return self._precision() + D.T @ (W[..., None] * D), W

    def _precision(self) -> Tensor:
        # Cholesky, because torch's batched LU fails after its number of threads was changed.
        return torch.cholesky_inverse(torch.linalg.cholesky(self._error_covariance()))

    def _error_covariance(self) -> Tensor:
        """Return ``K`` (C, n, n), float64."""
        return covariance(self.error_models, self.times, self.factors, self.growth)

    def _changes_under(self, corrections: Tensor) -> Tensor:
        """Return ``Δ`` (n - 1 or n - 2, C, d) under corrections (n, C, d)."""
        n, C, d = corrections.shape
        return self.steps + (self._difference @ corrections.flatten(1)).view(-1, C, d)

    @cached_property
    def _difference(self) -> Tensor:
        """``D`` (n - 1 or n - 2, n)."""
        return self.changes(torch.eye(len(self.times)).diff(dim=0))


@dataclass(frozen=True)
class FrameMatrices:
    """C constant matrices over n frames, as they are and transposed, each (C, n, n).

        y = M x,    grad_x = Mᵀ grad_y        x and y (C, n, d), a column for each axis

    With so few columns MKL takes four times as long for M x as for xᵀ Mᵀ with a matrix that lies
    row by row in memory. Therefore Mᵀ is kept beside M.
    """

    M: Tensor
    transposed: Tensor

    @staticmethod
    def of(M: Tensor) -> FrameMatrices:
        """Keep matrices (C, n, n) in both layouts."""
        return FrameMatrices(M.contiguous(), M.mT.contiguous())

    def __matmul__(self, x: Tensor) -> Tensor:
        """Return M x, (C, n, d), differentiable once in x (C, n, d)."""
        # Of a single column both forms are a product with a vector, whose orders differ.
        return self.M @ x if x.shape[-1] == 1 else _Product.apply(x, self)

    def product(self, x: Tensor, frames: list[int]) -> Tensor:
        """Return the rows of M x of r frames, (C, r, d)."""
        return self @ x if self._are_all(frames) else self.M[:, frames] @ x

    def rows(self, frames: list[int]) -> Tensor:
        """Return the rows of M of r frames, (C, r, n); of all frames without a copy."""
        return self.M if self._are_all(frames) else self.M[:, frames]

    def _are_all(self, frames: list[int]) -> bool:
        return frames == list(range(self.M.shape[1]))


class _Product(torch.autograd.Function):
    """Eq. 1."""

    @staticmethod
    def forward(ctx: FunctionCtx, x: Tensor, matrices: FrameMatrices) -> Tensor:
        ctx.matrices = matrices
        return _transposed(_transposed(x) @ matrices.transposed)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: FunctionCtx, grad: Tensor) -> tuple[Tensor, None]:
        return _transposed(_transposed(grad) @ ctx.matrices.M), None


def _transposed(x: Tensor) -> Tensor:
    return x.mT.contiguous()
