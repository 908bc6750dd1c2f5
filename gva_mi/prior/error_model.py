"""The error model of stage 1: sizes and correlations of its errors, by group of joints.

The error of an estimator in frame ``k`` is the negative of its correction. It is a sum of a white
part, which is independent in every frame, a slow part, which is correlated over some frames, and a
constant part:

1. ``e_k = white_k + slow_k + bias``
2. ``K_kl = white² f_k [k = l] + slow² g_k g_l κ(|t_k - t_l| / memory) + bias²``
   with ``κ(x) = (1 + √3 x) e^(-√3 x)``; an inferred model has ``bias = slow`` and ``g = 1``

``K`` is the covariance of each coordinate. The sizes of the parts and the memory differ between
estimators, and between hips and fingers. So each group of joints (:data:`GROUPS`) has its own. They
are known for the solver of :mod:`gva_mi.stage1` (:func:`stage1_errors`). For other estimators they
are inferred from the video:

3. ``white``: from third differences of the stage-1 poses. Third differences nearly remove slow
   errors and motion, and have 20 times the variance of white errors. Their median ignores outliers.
4. ``slow`` and ``memory``: from corrections *about the line of sight*, which images show well. Eq.
   2 is fitted to their autocovariance at some lags. The result is used for depth, too.
5. ``g_k² = 1 + (lag v_k / slow)²``, only of a known estimator: it errs more while a joint moves.
   ``v`` is the speed of a coordinate in the stage-1 poses, a root mean square over the memory.
6. ``f_k``: the outlier factor of a frame, for example of one that confuses both legs. It makes
   white errors follow Student's t distribution, a scale mixture of Gaussians of variance
   ``white² f``.
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

# Groups of joints that share an error model. Jaw and eyes are in none: refinement keeps them.
_JOINTS_OF_GROUP: Mapping[str, Sequence[str]] = {
    "pelvis": ("pelvis",), "spine": ("spine1", "spine2", "spine3"), "head": ("neck", "head"),
    "shoulders": ("collar", "shoulder"), "elbows": ("elbow",), "wrists": ("wrist",),
    "hips": ("hip",), "knees": ("knee",), "feet": ("ankle", "foot"),
}  # fmt: skip
GROUPS: Mapping[str, tuple[int, ...]] = MappingProxyType(
    {
        kind: tuple(i for i in range(22) if JOINTS[i].split("_")[-1] in names)
        for kind, names in _JOINTS_OF_GROUP.items()
    }
    | {"fingers": tuple(range(LEFT_HAND.start, RIGHT_HAND.stop))}
)

# Median of χ² with d degrees of freedom: the median square length of a vector whose d coordinates
# have variance 1.
_CHI_SQUARE_MEDIAN = {1: 0.4549, 3: 2.3660}
# ν of Student's t distribution. Chosen: two or three frames in a hundred are outliers.
STUDENT_DOF = 3.0
STUDENT_PEAK = 0.3676  # density of Student's t at 0 with that ν
CANDIDATE_MEMORIES = (1.5, 3.0, 6.0, 12.0, 24.0)  # frames, tried by eq. 4; chosen: each doubles
LARGEST_LAG = 12  # frames, of eq. 4; chosen: half the largest memory
WHITE_FLOOR = 0.1  # least white part, relative to the slow part; chosen: K must not be singular
DEFAULT_FPS = 30.0  # frames a second of a video that does not say its rate

# How our solver (gva_mi.stage1) errs: see stage1_errors() for the source of all numbers below.
STAGE1_MEMORY = 0.2  # seconds, memory of all joints
STAGE1_PLACE_MEMORY = 0.4  # seconds, memory of the person's position
# By group of joints: slow part and constant part (degrees), and lag (seconds).
_STAGE1_DEGREES = {
    "pelvis": (2.8, 2.1, 0.069),
    "spine": (1.0, 0.6, 0.267),
    "head": (2.8, 1.6, 0.216),
    "shoulders": (3.2, 2.3, 0.294),
    "elbows": (5.0, 2.3, 0.224),
    "wrists": (3.5, 2.0, 0.169),
    "hips": (2.7, 1.2, 0.154),
    "knees": (2.7, 1.2, 0.109),
    "feet": (0.5, 0.1, 0.331),
}
_STAGE1_METRES = {"aside": (0.026, 0.008), "depth": (0.065, 0.028)}  # slow and constant part


@dataclass(frozen=True)
class Stage1ErrorModel:
    """Error model of one group of joints, or of the person's position (eq. 2).

    Sizes are standard deviations of one coordinate, in radians, or in metres for the position.
    """

    white: float  # size of the white part
    slow: float  # size of the slow part
    memory: float  # frames over which the slow part is correlated
    bias: float | None = None  # size of the constant part; None: inferred model, same as ``slow``
    lag: float = 0.0  # frames: growth of the slow part per speed of the motion (eq. 5)

    @property
    def known(self) -> bool:
        """Whether the model is known for the estimator, and not inferred from the video."""
        return self.bias is not None

    @property
    def size(self) -> float:
        """Standard deviation of a coordinate without the constant part."""
        return float(np.hypot(self.white, self.slow))

    @property
    def white_variance(self) -> float:
        """``white²``, at least so large that eq. 2 is not singular."""
        return max(self.white, WHITE_FLOOR * self.slow) ** 2

    @property
    def constant(self) -> float:
        """Standard deviation of the constant part."""
        return self.slow if self.bias is None else self.bias

    def covariance_without_white(self, times: Tensor, growth: Tensor) -> Tensor:
        """Return ``K`` (n, n) of eq. 2 without its white part, float64.

        Args:
            times: (n,) frame numbers.
            growth: ``g`` (n,).
        """
        x = 3**0.5 * (times[:, None] - times).abs().double() / self.memory
        if self.bias is None:
            return self.slow**2 * ((1 + x) * torch.exp(-x) + 1)
        g = growth.double()
        return self.slow**2 * g[:, None] * g * (1 + x) * torch.exp(-x) + self.bias**2

    def growth(self, steps: Tensor, times: Tensor) -> Tensor:
        """Return ``g`` (n,) of eq. 5.

        Args:
            steps: (n - 1, d) from frame to frame of the stage-1 poses.
            times: (n,) frame numbers.
        """
        if self.lag == 0 or len(steps) == 0:
            return torch.ones(len(times))
        gaps = times.diff().to(steps)
        apart = (times[:, None] - times[:-1] - gaps / 2) / self.memory
        weights = torch.softmax(-apart.square() / 2, dim=1)
        square_speed = weights @ (steps.square().mean(-1) / gaps.square())
        return sqrt(1 + (self.lag / self.slow) ** 2 * square_speed)


def covariance(
    error_models: Sequence[Stage1ErrorModel], times: Tensor, factors: Tensor, growth: Tensor
) -> Tensor:
    """Return ``K`` (C, n, n) of eq. 2 for C models, float64.

    Args:
        error_models: C of them.
        times: (n,) frame numbers.
        factors: ``f`` (C, n).
        growth: ``g`` (C, n).
    """
    correlated = [
        x.covariance_without_white(times, g) for x, g in zip(error_models, growth, strict=True)
    ]
    white = torch.tensor([x.white_variance for x in error_models], dtype=torch.float64)
    diagonal = torch.diag_embed(white[:, None] * factors.double())
    return torch.stack(correlated) + diagonal


def median_of_square(dimension: int) -> float:
    """Return the median square length of a vector whose coordinates have variance 1."""
    return _CHI_SQUARE_MEDIAN[dimension]


def white_level(steps: Tensor) -> float:
    """Estimate the size of white errors (eq. 3) from steps (n, C, d); 0 for too few frames."""
    if len(steps) < 3:
        return 0.0
    third = steps[2:] - 2 * steps[1:-1] + steps[:-2]
    square = third.square().sum(-1).median() / median_of_square(steps.shape[-1])
    return float(sqrt(square / 20))


def fit_slow_part(
    errors: Tensor, times: Tensor, white: float, guess: Stage1ErrorModel
) -> Stage1ErrorModel:
    """Fit the slow part and its memory (eq. 4).

    Args:
        errors: (n, J) of a coordinate that images show well.
        times: (n,) frame numbers.
        white: size of the white part.
        guess: the model before; it counts as much as ``LARGEST_LAG`` frames.
    """
    from scipy.optimize import nnls

    gaps = times[None] - times[:, None]
    products = (errors @ errors.T / errors.shape[1]).double()
    longest = min(LARGEST_LAG, len(times) // 3)
    lags = [lag for lag in range(longest + 1) if bool((gaps == lag).any())]
    C = np.array([float(products[gaps == lag].mean()) for lag in lags])
    C[0] = max(C[0] - white**2, 0.0)
    # Lags that occur more often weigh more.
    weight = np.sqrt([int((gaps == lag).sum()) for lag in lags])
    fits = []
    for memory in CANDIDATE_MEMORIES:
        x = 3**0.5 * np.array(lags) / memory
        columns = np.stack([(1 + x) * np.exp(-x), np.ones_like(x)], axis=1)
        (slow, _), residual = nnls(columns * weight[:, None], C * weight)
        fits.append((residual, memory, slow))
    _, memory, slow = min(fits)
    trust = len(times) / (len(times) + LARGEST_LAG)
    slow = trust * slow + (1 - trust) * guess.slow**2
    return Stage1ErrorModel(white, float(slow**0.5), memory)


def outlier_factors(
    errors: Tensor, K: Tensor, error_models: Sequence[Stage1ErrorModel], factors: Tensor
) -> Tensor:
    """Return updated outlier factors ``f`` (C, n) of eq. 6.

    Args:
        errors: (C, n, d).
        K: (C, n, n) eq. 2 with the factors before.
        error_models: C of them.
        factors: (C, n) before.
    """
    variance = torch.tensor([x.white_variance for x in error_models])[:, None, None]
    # Expectation of the white part, given all errors.
    solved = torch.cholesky_solve(errors.double(), torch.linalg.cholesky(K))
    white = variance * factors[..., None] * solved
    square = (white.square() / variance).sum(-1)
    return ((STUDENT_DOF + square) / (STUDENT_DOF + errors.shape[-1])).float()


def stage1_errors(fps: float) -> dict[str, Stage1ErrorModel]:
    """Return the known error models of our own solver, :mod:`gva_mi.stage1`, by group of joints.

    A single video cannot show them: a constant error is invisible in a track, and a smooth error
    looks like motion. They were measured instead. ``python -m tools.stage1_errors`` printed the
    rows of joints, from the solver's poses of nine rendered videos of people in rooms: turns
    (seeds 27 and 61), half a turn (29, 63), everyday motion (28, 62), and arms at the body (51-53).

    Two choices differ from what was measured. All joints have one memory: longer memories fit the
    errors of shoulders better, but made the refinement worse. The rows of the position are wider
    than the measured errors; narrower rows hardly change the result.

    Fingers are left out, so their errors are inferred. They err by 18°, but small images cannot
    bend them better.

    Args:
        fps: frames a second of the video, in which memory and lag are expressed.
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
