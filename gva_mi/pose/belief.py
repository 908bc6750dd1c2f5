"""What is believed of a motion before pictures are looked at: stage 1, its errors, and inertia.

Stage 1 says ``y_k``, in truth it is ``x_k = y_k + δ_k``. Together, how stage 1 errs
(:mod:`gva_mi.pose.noise`) and how people move (:mod:`gva_mi.pose.motion`) give the corrections
``δ`` of one joint, or of one coordinate of a place, the energy

1. ``E(δ) = 1/2 Σ_kl δ_k · P_kl δ_l + Σ_k cost(Δ_k)``,   ``P = K⁻¹``,   ``Δ_k = m_k + δ_k+1 - δ_k``

with ``m_k = y_k+1 - y_k``; for a joint ``log(R_kᵀ R_k+1)``, in its own axes. It is a negative
logarithm of a probability. Near some ``δ`` it is as curved as

2. ``H = P + Dᵀ W D``,    ``D δ = (δ_k+1 - δ_k)``,   ``W`` the stiffness of each step

so its least value, which is what can be known without any picture, is found by solving ``H δ = -Dᵀ
W m`` some times with new ``W``, and new factors ``f`` of the noise.

``H`` also says in which coordinates ``u`` an optimiser should move ``δ``:

3. ``δ = M u``,    ``M = min(H⁻¹ / h, 1)^(1/2)``,    ``h`` the mean variance, by eigenvalues

What stage 1 gets wrong for many frames then moves in large steps, and what is improbable, such as a
tremor where errors are slow, in small ones (in the spirit of Nicolet et al., *Large Steps in
Inverse Rendering*, 2021).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from gva_mi.pose import motion
from gva_mi.pose.noise import Noise, covariance, worse_than_usual

ROUNDS = 8  # of eq. 2
LEAST_SPEED = 0.02  # of the errors' size, in a frame: no joint is believed to stand stiller


@dataclass(frozen=True)
class Belief:
    """About some joints, or coordinates of a place: C of them in n frames, each a vector of d.

    Attributes:
        times: (n,) numbers of the frames.
        steps: (n - 1, C, d) ``m``; for those that move steadily (n - 2, C, d), its changes.
        noises: C of them.
        factors: (C, n) ``f``.
        square_speed: (n - 1 or n - 2, C) ``s²`` of each step.
        steady: whether to move on is as probable as to rest.
    """

    times: Tensor
    steps: Tensor
    noises: Sequence[Noise]
    factors: Tensor
    square_speed: Tensor
    steady: bool

    @staticmethod
    def of_stage1(
        times: Tensor, steps: Tensor, noises: Sequence[Noise], steady: bool = False
    ) -> Belief:
        """What stage 1 alone tells.

        Args:
            times: (n,) numbers of the frames.
            steps: (n - 1, C, d) from frame to frame.
            noises: C of them, as far as they are known.
            steady: as above.
        """
        factors = torch.ones(steps.shape[1], len(times))
        belief = Belief(times, steps, noises, factors, steps[..., 0], steady)
        belief = replace(belief, steps=belief.changes(steps))
        white = torch.tensor([noise.white for noise in noises]).square()
        of_white = 4 if steady else 2  # the variance of a change, for white errors of variance 1
        seen = [
            motion.usual_square(motion.excursions(belief.steps, span)) - of_white * white / span
            for span in motion.SPANS
        ]
        return belief.moving(torch.stack(seen).amax(0).clamp(min=0))

    def changes(self, steps: Tensor) -> Tensor:
        """``Δ`` of steps (n - 1, ...) from frame to frame: those that have inertia."""
        if not self.steady:
            return steps
        gaps = self.times.diff().to(steps.dtype).view(-1, *[1] * (steps.ndim - 1))
        return (steps / gaps).diff(dim=0)

    def moving(self, square_speed: Tensor) -> Belief:
        """The same with other speeds, at each step."""
        sizes = torch.tensor([noise.size for noise in self.noises])
        return replace(self, square_speed=square_speed + (LEAST_SPEED * sizes).square())

    def with_noise(self, noises: Sequence[Noise]) -> Belief:
        """The same with other errors of stage 1."""
        return replace(self, noises=noises)

    def doubting(self, corrections: Tensor) -> Belief:
        """The same with the factors that follow from corrections (n, C, d)."""
        K = covariance(self.noises, self.times, self.factors)
        errors = -corrections.transpose(0, 1)
        return replace(self, factors=worse_than_usual(errors, K, self.noises, self.factors))

    def likeliest(self) -> tuple[Tensor, Belief]:
        """The corrections (n, C, d) of least energy, and the belief with their factors."""
        belief, D = self, self._difference().double()
        corrections = torch.zeros(len(self.times), *self.steps.shape[1:])
        for round in range(ROUNDS):
            # At first a step is taken for no jump, however large: else nothing would move at all.
            H, W = belief._curvature(corrections, jumps=round >= ROUNDS // 2)
            pull = torch.einsum("pk,cp,pcd->ckd", D, W, self.steps.double())
            corrections = (
                torch.cholesky_solve(-pull, torch.linalg.cholesky(H)).transpose(0, 1).float()
            )
            belief = belief.doubting(corrections)
        return corrections, belief

    def energy(self, precision: Tensor, corrections: Tensor, own: Tensor) -> Tensor:
        """Eq. 1.

        Args:
            precision: ``P`` (C, n, n).
            corrections: (n, C, d) in axes in which stage 1's errors last, such as the camera's.
            own: the same in the axes of ``steps``.
        """
        e = corrections.transpose(0, 1)
        moved = motion.cost(self._changed(own), self.square_speed)
        return (e * (precision @ e)).sum() / 2 + moved.sum()

    def variance_of_mean(self, bias: bool) -> Tensor:
        """Of stage 1's errors, of one coordinate, over all frames (C,); with their bias or not."""
        K = covariance(self.noises, self.times, self.factors).mean((1, 2))
        without = torch.tensor([noise.slow**2 for noise in self.noises])
        return (K if bias else K - without).float()

    def precision(self) -> Tensor:
        """``P`` (C, n, n)."""
        return self._precision().float()

    def covariance(self, corrections: Tensor) -> Tensor:
        """``H⁻¹`` (C, n, n) float64, of one coordinate, near some corrections (n, C, d)."""
        return torch.cholesky_inverse(torch.linalg.cholesky(self._curvature(corrections)[0]))

    def spread(self, corrections: Tensor) -> Tensor:
        """``M`` (C, n, n), eq. 3, near some corrections (n, C, d)."""
        values, vectors = torch.linalg.eigh(self._curvature(corrections)[0])
        gain = (1 / values / (1 / values).mean(1, keepdim=True)).clamp(max=1).sqrt()
        return ((vectors * gain[:, None]) @ vectors.mT).float()

    def _curvature(self, corrections: Tensor, jumps: bool = True) -> tuple[Tensor, Tensor]:
        """``H`` (C, n, n) and the diagonal of ``W`` (C, n - 1 or n - 2), float64."""
        D, changes = self._difference(), self._changed(corrections)
        W = motion.stiffness(changes if jumps else 0 * changes, self.square_speed).double().T
        D = D.double()
        return self._precision() + D.T @ (W[..., None] * D), W

    def _precision(self) -> Tensor:
        # By Cholesky: torch's LU of many matrices fails once the number of its threads was changed.
        K = covariance(self.noises, self.times, self.factors)
        return torch.cholesky_inverse(torch.linalg.cholesky(K))

    def _changed(self, corrections: Tensor) -> Tensor:
        """``Δ`` (n - 1 or n - 2, C, d) under corrections (n, C, d)."""
        n, C, d = corrections.shape
        return self.steps + (self._difference() @ corrections.flatten(1)).view(-1, C, d)

    def _difference(self) -> Tensor:
        """``D`` (n - 1 or n - 2, n)."""
        return self.changes(torch.eye(len(self.times)).diff(dim=0))
