"""The Gaussians as flat arrays: what the kernels take, and where their gradients go.

Both doors (autograd.py, drjit_op.py) hand their arrays over in this form, without copies.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import drjit as dr
import numpy as np
from drjit import ArrayBase as Array

from gva_mi.splat.kernels import packets
from gva_mi.splat.kernels.packets import Allocate
from gva_mi.splat.kernels.records import Format, ViewGradient
from gva_mi.splat.options import SplatOptions


@dataclass(frozen=True)
class Inputs:
    """What is differentiated, as flat Dr.Jit arrays of one precision; also gradients, tangents."""

    means: Array  # 3 N
    quats: Array  # 4 N
    scales: Array  # 3 N
    opacities: Array  # N
    colors: Array  # D N channels, or 3 K N coefficients of harmonics

    def __iter__(self) -> Iterator[Array]:
        """The arrays, in the order above."""
        return (getattr(self, field.name) for field in fields(self))

    def __len__(self) -> int:
        """N, the number of Gaussians."""
        return dr.width(self.opacities)

    @property
    def float_type(self) -> type:
        """``drjit.llvm.Float`` or ``Float64``."""
        return type(self.means)

    @property
    def color_width(self) -> int:
        """Numbers of each Gaussian in ``colors``."""
        return dr.width(self.colors) // max(1, len(self))

    def zeros(self) -> Inputs:
        """Arrays of the same sizes, of zeros."""
        return Inputs(*(dr.zeros(self.float_type, dr.width(array)) for array in self))

    def lane(self) -> Array:
        """The numbers of all Gaussians, one in each lane of a kernel."""
        return dr.arange(dr.uint32_array_t(self.float_type), len(self))

    def require_finite(self, harmonics: bool) -> None:
        """Name the first number that is NaN or infinite.

        Args:
            harmonics: whether ``colors`` holds coefficients.

        Raises:
            ValueError: there is one.
        """
        n = len(self)
        for name, array in zip((field.name for field in fields(self)), self, strict=True):
            numbers = array.numpy()
            bad = np.flatnonzero(~np.isfinite(numbers))
            if not bad.size:
                continue
            shape = (n, -1) if numbers.size > n else (n,)
            if name == "colors" and harmonics:
                name, shape = "sh", (n, -1, 3)
            index = np.unravel_index(bad[0], numbers.reshape(shape).shape)
            where = ", ".join(str(i) for i in index)
            count = f" ({bad.size} such numbers)" if bad.size > 1 else ""
            found = f"{name}[{where}] is {numbers[bad[0]]}"
            raise ValueError(f"render(): {found}, must be finite{count}")


@dataclass(frozen=True)
class Plan:
    """What is the same for all kernels of a picture: constants of their code."""

    options: SplatOptions  # of_code()
    harmonics: bool  # whether inputs.colors holds coefficients
    color_width: int  # numbers of each Gaussian in inputs.colors
    channels: int  # D
    formats: tuple[Format, ...]  # of the splats, chunk by chunk (chunks.py)
    covariances: bool = False  # whether scales and quats hold covariances (covariance.py)


@dataclass(frozen=True)
class Gaussian3D:
    """One Gaussian in each lane."""

    m: list[Array]  # mean
    quat: list[Array]
    s: list[Array]  # scales
    o: Array  # opacity
    color: list[Array]  # channels, or coefficients

    @staticmethod
    def load(inputs: Inputs, color_width: int, i: Array) -> Gaussian3D:
        """The Gaussians with the numbers ``i``."""
        F = inputs.float_type
        m = [dr.gather(F, inputs.means, 3 * i + k) for k in range(3)]
        s = [dr.gather(F, inputs.scales, 3 * i + k) for k in range(3)]
        quat = packets.load_rows(inputs.quats, 4, i)
        o = dr.gather(F, inputs.opacities, i)
        return Gaussian3D(m, quat, s, o, packets.load_rows(inputs.colors, color_width, i))


@dataclass(frozen=True)
class Wanted:
    """Which gradients an adjoint is asked for: constants of its kernels' code."""

    geometry: bool = True  # by all that is no colour: means to opacities, means2d, the camera
    colors: bool = True  # or coefficients
    camera: bool = False
    absolute: bool = False  # by means2d, with every pixel's share taken absolutely


@dataclass(frozen=True)
class GradientMemory:
    """Where the gradients are written; None for one that was not asked for."""

    inputs: Inputs
    u: Array | None  # 2 N, by the mean in the picture, per px
    absolute: Array | None  # 2 N, the same with every pixel's share taken absolutely
    view: packets.Packets | None  # a ViewGradient for each Gaussian

    @staticmethod
    def empty(
        F: type,
        n: int,
        color_width: int,
        wanted: Wanted,
        allocate: Allocate = packets.memory,
    ) -> GradientMemory:
        """Memory for the gradients of n Gaussians."""
        rows = lambda columns, asked: allocate(F, columns * n) if asked else None
        return GradientMemory(
            Inputs(
                *(rows(columns, wanted.geometry) for columns in (3, 4, 3, 1)),
                rows(color_width, wanted.colors),
            ),
            rows(2, wanted.geometry),
            rows(2, wanted.absolute),
            packets.empty(ViewGradient, None, n, F, allocate) if wanted.camera else None,
        )

    def store(self, grad: Gaussian3D, grad_u: list[Array], i: Array) -> None:
        """Write the gradients of the Gaussians ``i``, but for the colours."""
        target, mode = self.inputs, dr.ReduceMode.NoConflicts
        for k in range(3):
            dr.scatter(target.means, grad.m[k], 3 * i + k, mode=mode)
            dr.scatter(target.scales, grad.s[k], 3 * i + k, mode=mode)
        packets.store_rows(target.quats, grad.quat, i)
        packets.store_rows(self.u, grad_u, i)
        dr.scatter(target.opacities, grad.o, i, mode=mode)
