"""The numbers of Gaussians that every file stores: finite, in float64, with spherical harmonics."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from gva_mi.core.errors import InputError
from gva_mi.splat.gaussians import Gaussians
from gva_mi.splat.geometry import with_axes
from gva_mi.splat.kernels.sh import C0

_TINY = 1e-12  # the least scale and length of a quaternion


@dataclass(frozen=True)
class Stored:
    """Arrays of N Gaussians, all finite."""

    means: np.ndarray  # (N, 3) metres
    quats: np.ndarray  # (N, 4) wxyz of any length
    scales: np.ndarray  # (N, 3) metres
    opacities: np.ndarray  # (N,) in [0, 1]
    sh: np.ndarray  # (N, K, 3)

    @staticmethod
    def of(path: Path, gaussians: Gaussians) -> Stored:
        """Convert torch tensors; plain colours become the constant band.

        Raises:
            InputError: numbers that float32 cannot hold, such as NaN, named with ``path``.
        """
        bad = ~_finite(gaussians)
        if bad.any():
            raise InputError(
                f"{path}: {int(bad.sum())} of {len(gaussians)} Gaussians hold NaN or infinite "
                f"numbers, the first is number {int(bad.nonzero()[0])}; expected finite ones"
            )
        axes = with_axes(gaussians)
        tensors = axes.means, axes.quats, axes.scales, axes.opacities, _harmonics(axes)
        return Stored(*(tensor.detach().double().numpy() for tensor in tensors))

    @property
    def degree(self) -> int:
        """Degree of the spherical harmonics."""
        return round(self.sh.shape[1] ** 0.5) - 1

    @property
    def log_scales(self) -> np.ndarray:
        """Logarithms of the scales, (N, 3), of 1e-12 metres at least."""
        return np.log(np.maximum(self.scales, _TINY))

    @property
    def unit_quats(self) -> np.ndarray:
        """Quaternions wxyz of length 1, (N, 4)."""
        return self.quats / np.maximum(np.linalg.norm(self.quats, axis=1, keepdims=True), _TINY)

    @property
    def rest(self) -> np.ndarray:
        """Coefficients above the constant one, channel by channel, (N, 3 (K - 1)): f_rest."""
        count = 3 * (self.sh.shape[1] - 1)
        return self.sh[:, 1:].transpose(0, 2, 1).reshape(len(self.sh), count)


def finite_ones(path: Path, gaussians: Gaussians) -> Gaussians:
    """Leave out the Gaussians that hold NaN or infinite numbers.

    Raises:
        InputError: none is left; ``path`` is named.
    """
    keep = _finite(gaussians)
    if keep.all():
        return gaussians
    if not keep.any():
        raise InputError(f"{path}: all {len(gaussians)} Gaussians hold NaN or infinite numbers")
    return replace(gaussians, **{name: x[keep] for name, x in gaussians.arrays().items()})


def with_degree(gaussians: Gaussians, degree: int) -> Gaussians:
    """Give Gaussians spherical harmonics of a degree: cut, or filled up with zeros."""
    sh, count = _harmonics(gaussians), (degree + 1) ** 2
    more = sh.new_zeros(len(sh), max(count - sh.shape[1], 0), 3)
    return replace(gaussians, colors=None, sh=torch.cat([sh[:, :count], more], dim=1))


def _harmonics(gaussians: Gaussians) -> Tensor:
    """Return coefficients (N, K, 3); plain colours become the constant band, in float64."""
    if gaussians.sh is not None:
        return gaussians.sh
    return ((gaussians.colors.double() - 0.5) / C0)[:, None]


def _finite(gaussians: Gaussians) -> Tensor:
    """Whether all numbers of each Gaussian are finite in float32, (N,).

    So are those of its rotation, which a quaternion of no length has not.
    """
    arrays = gaussians.arrays()
    rows = [torch.isfinite(x.detach().float())[:, None].flatten(1).all(1) for x in arrays.values()]
    if "quats" in arrays:
        rows.append(arrays["quats"].detach().abs().sum(1) > 0)
    return torch.stack(rows).all(0)
