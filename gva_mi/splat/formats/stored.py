"""Parts of all file formats: the numbers to store, rounding to bits, and Gaussians read back."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from gva_mi.core.errors import InputError
from gva_mi.splat.axes import with_axes
from gva_mi.splat.gaussians import Gaussians
from gva_mi.splat.kernels.sh import C0

# Bound of scales (m), whose logarithm is stored, and of quaternion lengths; below any Gaussian's.
_SMALLEST = 1e-12


@dataclass(frozen=True)
class Stored:
    """Numbers of N Gaussians, all finite, in float64.

    Example:
        >>> from gva_mi.splat.scene import random_scene
        >>> g = random_scene(torch.Generator().manual_seed(0), gaussians=5, degree=1).gaussians
        >>> stored = Stored.of(Path("five.ply"), g)
        >>> stored.degree, stored.rest.shape
        (1, (5, 9))
    """

    means: np.ndarray  # (N, 3) metres
    quats: np.ndarray  # (N, 4) wxyz of any length
    scales: np.ndarray  # (N, 3) metres
    opacities: np.ndarray  # (N,) in [0, 1]
    sh: np.ndarray  # (N, K, 3)

    @staticmethod
    def of(path: Path, gaussians: Gaussians, kind: str = "", most: int = 4) -> Stored:
        """Convert torch tensors; plain colours become the constant band.

        Raises:
            InputError: numbers that float32 cannot hold, such as NaN, or harmonics of a degree
                above ``most``, which this kind of file lacks.
        """
        bad = ~_finite(gaussians)
        if bad.any():
            raise InputError(
                f"{path}: {int(bad.sum())} of {len(gaussians)} Gaussians hold NaN or infinite "
                f"numbers, the first is number {int(bad.nonzero()[0])}; expected finite ones"
            )
        axes = with_axes(gaussians)
        tensors = axes.means, axes.quats, axes.scales, axes.opacities, _harmonics(axes)
        stored = Stored(*(tensor.detach().double().numpy() for tensor in tensors))
        if stored.degree > most:
            limit = f"{kind} holds harmonics up to degree {most}"
            raise InputError(f"{path}: {limit}, got {stored.degree}")
        return stored

    @property
    def degree(self) -> int:
        """Degree of the spherical harmonics."""
        return round(self.sh.shape[1] ** 0.5) - 1

    @property
    def log_scales(self) -> np.ndarray:
        """Logarithms of the scales, (N, 3), of 1e-12 metres at least."""
        return np.log(np.maximum(self.scales, _SMALLEST))

    @property
    def unit_quats(self) -> np.ndarray:
        """Quaternions wxyz of length 1, (N, 4)."""
        return self.quats / np.maximum(np.linalg.norm(self.quats, axis=1, keepdims=True), _SMALLEST)

    @property
    def rest(self) -> np.ndarray:
        """Coefficients above the constant one, channel by channel, (N, 3 (K - 1)): f_rest."""
        count = 3 * (self.sh.shape[1] - 1)
        return self.sh[:, 1:].transpose(0, 2, 1).reshape(len(self.sh), count)


def gaussians_of(**arrays: np.ndarray) -> Gaussians:
    """Return Gaussians of float32 tensors from arrays of any type, named as their fields.

    Example:
        >>> zero, one = np.zeros((1, 3)), np.ones(1)
        >>> arrays = {"means": zero, "scales": zero, "opacities": one, "colors": zero}
        >>> gaussians_of(quats=np.eye(4)[:1], **arrays).means.dtype
        torch.float32
    """
    copies = {k: np.array(x, np.float32, order="C") for k, x in arrays.items()}
    return Gaussians(**{k: torch.from_numpy(x) for k, x in copies.items()})


def from_rest(constant: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """Return coefficients (N, K, 3) from the constant ones (N, 3) and :attr:`Stored.rest`.

    Example:
        >>> from_rest(np.zeros((1, 3)), np.arange(9.0)[None])[0, 1].tolist()  # of red, green, blue
        [0.0, 3.0, 6.0]
    """
    higher = rest.reshape(len(rest), 3, rest.shape[1] // 3).transpose(0, 2, 1)
    return np.concatenate([constant[:, None], higher], axis=1)


def to_bytes(x: np.ndarray) -> np.ndarray:
    """Round numbers to 0 ... 255.

    Example:
        >>> to_bytes(np.array([-3, 2.6, 999])).tolist()
        [0, 3, 255]
    """
    return np.round(np.clip(x, 0, 255)).astype(np.uint8)


def pack(numbers: np.ndarray, bits: tuple[int, ...]) -> np.ndarray:
    """Pack whole numbers (N, len(bits)) of so many bits each, the last one lowest, (N,) uint32.

    Example:
        >>> pack(np.array([[1, 2]]), (2, 4)).tolist()  # 0b01_0010
        [18]
    """
    packed = np.zeros(len(numbers), np.int64)
    for column, width in zip(numbers.T, bits, strict=True):
        packed = packed << width | column.astype(np.int64)
    return packed.astype("<u4")


def without_largest(quats: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the index (N,) of the largest component of unit quaternions (N, 4), and the others.

    The others (N, 3) have the sign that makes the largest positive, and lie in ±√½.

    Example:
        >>> index, others = without_largest(np.array([[0.1, 0.1, -0.99, 0.0]]))
        >>> index.tolist(), others.tolist()
        ([2], [[-0.1, -0.1, -0.0]])
    """
    largest = np.abs(quats).argmax(axis=1)
    signs = np.where(quats[np.arange(len(quats)), largest] < 0, -1, 1)
    others = (quats * signs[:, None])[np.arange(4) != largest[:, None]]
    return largest, others.reshape(-1, 3)


def with_degree(gaussians: Gaussians, degree: int) -> Gaussians:
    """Give Gaussians spherical harmonics of a degree: cut, or filled up with zeros.

    Example:
        >>> from gva_mi.splat.scene import random_scene
        >>> g = random_scene(torch.Generator().manual_seed(0), gaussians=5, degree=3).gaussians
        >>> tuple(with_degree(g, 1).sh.shape)
        (5, 4, 3)
    """
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

    A quaternion of length 0 counts as not finite, because it has no rotation.
    """
    arrays = gaussians.arrays()
    rows = [torch.isfinite(x.detach().float())[:, None].flatten(1).all(1) for x in arrays.values()]
    if "quats" in arrays:
        rows.append(arrays["quats"].detach().abs().sum(1) > 0)
    return torch.stack(rows).all(0)
