"""The error model of stage 1, inferred from the video itself.

An estimator's error in frame ``k`` is the negative of its correction. It has a part that is new in
every frame, one that lasts for some frames, and a constant one:

1. ``e_k = white_k + slow_k + bias``
2. ``K_kl = white² f_k [k = l] + slow² g_k g_l κ(|t_k - t_l| / memory) + bias²``
   with ``κ(x) = (1 + √3 x) e^(-√3 x)``; an inferred model has ``bias = slow`` and ``g = 1``

``K`` is the covariance of each of its coordinates. The parts' sizes and the memory differ between
estimators, and between hips and fingers, so they are inferred for each group of joints
(:data:`GROUPS`):

3. ``white``: from third differences of stage 1. They nearly remove lasting errors and motion, and a
   median ignores outliers; they have 20 times the variance of white errors.
4. ``slow`` and ``memory``: from the corrections *about the line of sight*, which images show well.
   Their autocovariance at some lags is fitted by eq. 2, and then used for depth, too.
5. ``g_k² = 1 + (lag v_k / slow)²`` if the estimator is known: it errs more while a joint moves.
   ``v`` is the speed of a coordinate of stage 1 itself, a root mean square over the memory.
6. ``f_k``: the outlier factor of a frame, such as one in which a leg was taken for the other: that
   of Student's t distribution as a scale mixture of Gaussians of variance ``white² f``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.pose import JOINTS, LEFT_HAND, RIGHT_HAND
from gva_mi.core.cpu import sqrt

# Joints that stage 1 is taken to know equally well. Jaw and eyes are in none: they are not turned.
_KINDS: Mapping[str, Sequence[str]] = {
    "pelvis": ("pelvis",), "spine": ("spine1", "spine2", "spine3"), "head": ("neck", "head"),
    "shoulders": ("collar", "shoulder"), "elbows": ("elbow",), "wrists": ("wrist",),
    "hips": ("hip",), "knees": ("knee",), "feet": ("ankle", "foot"),
}  # fmt: skip
GROUPS: Mapping[str, tuple[int, ...]] = MappingProxyType(
    {
        kind: tuple(i for i in range(22) if JOINTS[i].split("_")[-1] in names)
        for kind, names in _KINDS.items()
    }
    | {"fingers": tuple(range(LEFT_HAND.start, RIGHT_HAND.stop))}
)

# Medians of χ²: of the square length of a vector whose d coordinates have variance 1.
_MEDIAN = {1: 0.4549, 3: 2.3660}
FREEDOM = 3.0  # ν of Student's t: two or three frames in a hundred are far off
T_PEAK = 0.3676  # of Student's t with that freedom
MEMORIES = (1.5, 3.0, 6.0, 12.0, 24.0)  # frames, candidates of eq. 4
LAGS = 12  # largest lag of eq. 4, frames
LEAST_WHITE = 0.1  # relative to the slow part; keeps eq. 2 from being singular
STAGE1_FPS = 30.0  # frames a second of a video that does not say it

STAGE1_MEMORY = 0.2  # seconds that the slow errors of joints last
STAGE1_PLACE_MEMORY = 0.4  # the same of the position

# Standard deviations of the slow part and of the constant one, and seconds of lag: what the slow
# one grows by, relative to the speed.
_STAGE1_DEGREES = {
    "pelvis": (1.0, 0.0, 0.054),
    "spine": (1.3, 0.3, 0.248),
    "head": (3.0, 1.4, 0.0),
    "shoulders": (5.3, 2.3, 0.094),
    "elbows": (5.6, 1.7, 0.115),
    "wrists": (4.1, 1.5, 0.122),
    "hips": (3.1, 1.0, 0.097),
    "knees": (1.4, 0.0, 0.187),
    "feet": (0.8, 0.0, 0.337),
}
_STAGE1_METRES = {"aside": (0.026, 0.008), "depth": (0.065, 0.028)}


@dataclass(frozen=True)
class Stage1ErrorModel:
    """The errors of one group of joints, or of the person's position (eq. 2)."""

    white: float  # standard deviation of a coordinate; radians, or metres for the position
    slow: float  # the same of the part that lasts
    memory: float  # frames that it lasts
    bias: float | None = None  # of the constant part; None: the same as ``slow``
    lag: float = 0.0  # frames: what is added to ``slow``, relative to the speed of the motion

    @property
    def known(self) -> bool:
        """Whether this is knowledge about the estimator, and not inferred from the video."""
        return self.bias is not None

    @property
    def size(self) -> float:
        """Standard deviation of a coordinate, without the bias."""
        return float(np.hypot(self.white, self.slow))

    @property
    def white_variance(self) -> float:
        """``white²``, but large enough that eq. 2 is not singular."""
        return max(self.white, LEAST_WHITE * self.slow) ** 2

    @property
    def constant(self) -> float:
        """Standard deviation of the constant part."""
        return self.slow if self.bias is None else self.bias

    def lasting(self, times: Tensor, growth: Tensor) -> Tensor:
        """Return eq. 2 (n, n) float64 at times (n,) with ``g`` (n,), without the white part."""
        x = 3**0.5 * (times[:, None] - times).abs().double() / self.memory
        if self.bias is None:
            return self.slow**2 * ((1 + x) * torch.exp(-x) + 1)
        g = growth.double()
        return self.slow**2 * g[:, None] * g * (1 + x) * torch.exp(-x) + self.bias**2

    def growth(self, steps: Tensor, times: Tensor) -> Tensor:
        """Return ``g`` (n,) of steps (n - 1, d) of stage 1 between times (n,), eq. 5."""
        if self.lag == 0 or len(steps) == 0:
            return torch.ones(len(times))
        gaps = times.diff().to(steps)
        apart = (times[:, None] - times[:-1] - gaps / 2) / self.memory
        weights = torch.softmax(-apart.square() / 2, dim=1)
        square_speed = weights @ (steps.square().mean(-1) / gaps.square())
        return sqrt(1 + (self.lag / self.slow) ** 2 * square_speed)


def covariance(
    error_models: Sequence[Stage1ErrorModel],
    times: Tensor,
    factors: Tensor,
    growth: Tensor,
) -> Tensor:
    """Return eq. 2 (C, n, n) float64 of C models at times (n,), with ``f`` and ``g`` (C, n)."""
    lasting = [noise.lasting(times, g) for noise, g in zip(error_models, growth, strict=True)]
    white = torch.tensor([noise.white_variance for noise in error_models], dtype=torch.float64)
    diagonal = torch.diag_embed(white[:, None] * factors.double())
    return torch.stack(lasting) + diagonal


def median_of_square(dimension: int) -> float:
    """Return the median square length of a vector whose coordinates have variance 1."""
    return _MEDIAN[dimension]


def white_level(steps: Tensor) -> float:
    """Return eq. 3, a standard deviation, from steps (n, C, d); zero for too few frames."""
    if len(steps) < 3:
        return 0.0
    third = steps[2:] - 2 * steps[1:-1] + steps[:-2]
    square = third.square().sum(-1).median() / median_of_square(steps.shape[-1])
    return float(sqrt(square / 20))


def fit_slow_part(
    errors: Tensor, times: Tensor, white: float, guess: Stage1ErrorModel
) -> Stage1ErrorModel:
    """Fit eq. 4 to errors (n, J) of a coordinate that images show well, at times (n,).

    ``white`` is the deviation of the white part; ``guess``, the model before, counts as ``LAGS``
    frames.
    """
    from scipy.optimize import nnls

    gaps = times[None] - times[:, None]
    products = (errors @ errors.T / errors.shape[1]).double()
    lags = [lag for lag in range(min(LAGS, len(times) // 3) + 1) if bool((gaps == lag).any())]
    C = np.array([float(products[gaps == lag].mean()) for lag in lags])
    C[0] = max(C[0] - white**2, 0.0)
    # Lags that occur more often weigh more.
    weight = np.sqrt([int((gaps == lag).sum()) for lag in lags])
    fits = []
    for memory in MEMORIES:
        x = 3**0.5 * np.array(lags) / memory
        columns = np.stack([(1 + x) * np.exp(-x), np.ones_like(x)], axis=1)
        (slow, _), residual = nnls(columns * weight[:, None], C * weight)
        fits.append((residual, memory, slow))
    _, memory, slow = min(fits)
    trust = len(times) / (len(times) + LAGS)
    slow = trust * slow + (1 - trust) * guess.slow**2
    return Stage1ErrorModel(white, float(slow**0.5), memory)


def outlier_factors(
    errors: Tensor, K: Tensor, error_models: Sequence[Stage1ErrorModel], factors: Tensor
) -> Tensor:
    """Update the factors ``f`` (C, n) of eq. 2 by errors (C, n, d); ``K`` (C, n, n) is of the
    present ones.
    """
    variance = torch.tensor([noise.white_variance for noise in error_models])[:, None, None]
    # The expectation of the white part, given all errors.
    white = (
        variance
        * factors[..., None]
        * torch.cholesky_solve(errors.double(), torch.linalg.cholesky(K))
    )
    square = (white.square() / variance).sum(-1)
    return ((FREEDOM + square) / (FREEDOM + errors.shape[-1])).float()


def stage1_errors(fps: float) -> dict[str, Stage1ErrorModel]:
    """Return the error models of a video of so many frames a second, by group of joints.

    They are how stage 1 errs, which is known before any video.
    A constant error does not show in a track, and a smooth one looks like motion: how large they
    are is knowledge about the estimator, and not about this video. The solver errs more while a
    joint moves. The rows of joints are what ``python -m tools.stage1_errors`` prints, of the
    solver of :mod:`gva_mi.stage1` on nine rendered videos with ground truth: five in rooms
    (turns, half a turn, a walk, everyday motion; seeds 120, 123, 125, 130, 131) and four before a
    white wall (seeds 101, 103, 104, 106). All joints have one memory, for the refinement gets worse
    with the longer ones that fit the errors of shoulders better. The rows of the position are wider
    than the errors that were found; narrower ones hardly change the result. Fingers are left out:
    they err by 18°, but images of this size cannot bend them better, and their errors are inferred.
    """
    rows = {name: (*np.radians(row[:2]).tolist(), row[2]) for name, row in _STAGE1_DEGREES.items()}
    joints = {
        name: Stage1ErrorModel(0.0, slow, STAGE1_MEMORY * fps, bias, lag * fps)
        for name, (slow, bias, lag) in rows.items()
    }
    return joints | {
        name: Stage1ErrorModel(0.0, slow, STAGE1_PLACE_MEMORY * fps, bias)
        for name, (slow, bias) in _STAGE1_METRES.items()
    }
