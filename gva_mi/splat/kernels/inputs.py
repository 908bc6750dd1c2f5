"""The Gaussians as the kernels take them, flat arrays, and where their gradients are written.

Both front ends (torch's torch_passes.py, Dr.Jit's drjit_render.py) hand their arrays over in this
form, without copies.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import drjit as dr
import numpy as np
from drjit import ArrayBase as Array

from gva_mi.jit import packets
from gva_mi.splat.argument_error import ArgumentError
from gva_mi.splat.kernels.geometry import Covariance, Geometry, QuatScale
from gva_mi.splat.kernels.records import CameraGradient, RecordFormat
from gva_mi.splat.options import SplatOptions


@dataclass(frozen=True)
class Inputs:
    """Differentiable inputs, or their gradients or tangents, as flat arrays of one precision."""

    means: Array  # 3 N
    geometry: Geometry
    opacities: Array  # N
    colors: Array  # D N channels, or 3 K N coefficients of harmonics

    @staticmethod
    def of_named(arrays: dict[str, Array]) -> Inputs:
        """Build the record from arrays by their names in ``Gaussians``."""
        a, colors = arrays, arrays["sh"] if "sh" in arrays else arrays["colors"]
        geometry = Covariance(a["covars"]) if "covars" in a else QuatScale(a["quats"], a["scales"])
        return Inputs(a["means"], geometry, a["opacities"], colors)

    def named(self) -> Iterator[tuple[str, Array]]:
        """Yield every array with its name in ``Gaussians``; harmonics are called colors too."""
        yield "means", self.means
        for field in fields(self.geometry):
            yield field.name, getattr(self.geometry, field.name)
        yield "opacities", self.opacities
        yield "colors", self.colors

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
        """Arrays of the same sizes, filled with zeros."""
        F = self.float_type
        return Inputs.of_named({k: dr.zeros(F, dr.width(x)) for k, x in self.named()})

    def index(self) -> Array:
        """The index of the Gaussian that each lane of a kernel works on."""
        return dr.arange(dr.uint32_array_t(self.float_type), len(self))

    def require_finite(self, harmonics: bool) -> None:
        """Check that no number is NaN or infinite.

        Args:
            harmonics: whether ``colors`` holds coefficients.

        Raises:
            ArgumentError: one is; the message names the first.
        """
        n = len(self)
        for name, array in self.named():
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
            problem = f"is {numbers[bad[0]]}, must be finite{count}"
            raise ArgumentError("render()", name, problem, f"[{where}]")


@dataclass(frozen=True)
class Plan:
    """Constants in the code of all kernels of a picture."""

    options: SplatOptions  # kernel_constants()
    harmonics: bool  # whether inputs.colors holds coefficients
    color_width: int  # numbers of each Gaussian in inputs.colors
    channels: int  # D
    formats: tuple[RecordFormat, ...]  # of the splats, one per chunk (chunks.py)


@dataclass(frozen=True)
class Gaussian3D:
    """One Gaussian per lane."""

    m: list[Array]  # mean
    geometry: Geometry  # columns
    o: Array  # opacity
    color: list[Array]  # channels, or coefficients

    @staticmethod
    def load(inputs: Inputs, color_width: int, i: Array) -> Gaussian3D:
        """Read the Gaussians ``i``."""
        F = inputs.float_type
        m = [dr.gather(F, inputs.means, 3 * i + k) for k in range(3)]
        geometry = inputs.geometry.load(i)
        o = dr.gather(F, inputs.opacities, i)
        return Gaussian3D(m, geometry, o, packets.load_rows(inputs.colors, color_width, i))


@dataclass(frozen=True)
class RequestedGradients:
    """Which gradients an adjoint computes: constants of its kernels' code."""

    geometry: bool = True  # by everything but the colours: means to opacities, means2d, the camera
    colors: bool = True  # or coefficients
    camera: bool = False
    absolute: bool = False  # by means2d, summing the absolute value of every pixel's share


@dataclass(frozen=True)
class GradientMemory:
    """Where the gradients are written; None for a gradient that was not requested.

    The rows of the Gaussians come first; there is unused memory behind them.
    """

    means: Array | None
    geometry: Geometry | None
    opacities: Array | None
    colors: Array | None
    u: Array | None  # 2 N, by the mean in the picture, per px
    absolute: Array | None  # 2 N, like u, with the absolute value of every pixel's share
    camera: packets.Packets | None  # a CameraGradient for each Gaussian

    @staticmethod
    def empty(
        inputs: Inputs, n: int, color_width: int, requested: RequestedGradients
    ) -> GradientMemory:
        """Allocate memory for the gradients of n Gaussians of the kind of ``inputs``.

        Only inside a frozen kernel.
        """
        F, geometry = inputs.float_type, requested.geometry
        rows = lambda columns, wanted: dr.empty(F, columns * n) if wanted else None
        return GradientMemory(
            rows(3, geometry),
            type(inputs.geometry).empty(F, n) if geometry else None,
            rows(1, geometry),
            rows(color_width, requested.colors),
            rows(2, geometry),
            rows(2, requested.absolute),
            packets.empty(CameraGradient, None, n, F) if requested.camera else None,
        )

    def store(self, grad: Gaussian3D, grad_u: list[Array], i: Array) -> None:
        """Write the gradients of the Gaussians ``i``, without the colours'."""
        mode = dr.ReduceMode.NoConflicts
        for k in range(3):
            dr.scatter(self.means, grad.m[k], 3 * i + k, mode=mode)
        self.geometry.store(grad.geometry, i)
        packets.store_rows(self.u, grad_u, i)
        dr.scatter(self.opacities, grad.o, i, mode=mode)
