"""The Gaussians and the camera as the kernels take them, and where their gradients are written.

Both front ends (torch's torch_passes.py, Dr.Jit's drjit_render.py) hand their flat arrays over in
this form, without copies. A covariance has two forms, ``QuatScale`` and ``Covariance``. Each exists
twice: in memory its fields are flat arrays of all Gaussians, and in a kernel they are vectors, one
Gaussian per SIMD lane. Gradients and tangents have the same form as the Gaussians. The
camera is a few arrays of size one, with a tangent and an adjoint of its own on the host.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields
from typing import Any

import drjit as dr
import numpy as np
from drjit import ArrayBase as Array
from drjit.llvm import Float64

from gva_mi.jit import packets
from gva_mi.splat.camera import ArgumentError, Camera, CameraModel
from gva_mi.splat.kernels.records import CameraGradient, RecordFormat
from gva_mi.splat.kernels.vectors import Mat3, Quat, Sym3, Vec2, Vec3, each
from gva_mi.splat.options import SplatOptions

Entrywise = Callable[[Array], Array]


@dataclass(frozen=True)
class QuatScale:
    """Sigma = M S S M^T, with the rotation M of a quaternion and S = diag(scales)."""

    quats: Any  # 4 N numbers wxyz; in a kernel a Quat
    scales: Any  # 3 N numbers, metres; in a kernel a Vec3

    @staticmethod
    def empty(F: type, n: int) -> QuatScale:
        """Allocate memory for n Gaussians, inside a frozen kernel."""
        return QuatScale(dr.empty(F, 4 * n), dr.empty(F, 3 * n))

    def load(self, i: Array) -> QuatScale:
        """Read the Gaussians ``i``."""
        scales = load_vector(self.scales, i)
        return QuatScale(Quat(*packets.load_rows(self.quats, 4, i)), scales)

    def store(self, values: QuatScale, i: Array) -> None:
        """Write the Gaussians ``i``."""
        store_vector(self.scales, values.scales, i)
        packets.store_rows(self.quats, values.quats, i)

    def numbers(self) -> list[Array]:
        """All numbers of a Gaussian, in a kernel."""
        return [*self.quats, *self.scales]

    def map(self, function: Entrywise) -> QuatScale:
        """Apply a function to each number, in a kernel."""
        return QuatScale(each(function, self.quats), each(function, self.scales))


@dataclass(frozen=True)
class Covariance:
    """Sigma by its upper triangle: xx, xy, xz, yy, yz, zz."""

    covars: Any  # 6 N numbers, square metres; in a kernel a Sym3

    @staticmethod
    def empty(F: type, n: int) -> Covariance:
        """Allocate memory for n Gaussians, inside a frozen kernel."""
        return Covariance(dr.empty(F, 6 * n))

    def load(self, i: Array) -> Covariance:
        """Read the Gaussians ``i``."""
        return Covariance(Sym3(*packets.load_rows(self.covars, 6, i)))

    def store(self, values: Covariance, i: Array) -> None:
        """Write the Gaussians ``i``."""
        packets.store_rows(self.covars, values.covars, i)

    def numbers(self) -> list[Array]:
        """All numbers of a Gaussian, in a kernel."""
        return list(self.covars)

    def map(self, function: Entrywise) -> Covariance:
        """Apply a function to each number, in a kernel."""
        return Covariance(each(function, self.covars))


Geometry = QuatScale | Covariance


def load_vector(flat: Array, i: Array) -> Vec3:
    """Read the rows ``i`` of an array of 3 N numbers."""
    return Vec3(*(dr.gather(type(flat), flat, 3 * i + k) for k in range(3)))


def store_vector(flat: Array, v: Vec3, i: Array) -> None:
    """Write the rows ``i`` of an array of 3 N numbers."""
    for k, number in enumerate(v):
        dr.scatter(flat, number, 3 * i + k, mode=dr.ReduceMode.NoConflicts)


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
            ArgumentError: a number is; the message names the first.
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

    m: Vec3  # mean
    geometry: Geometry  # of vectors
    o: Array  # opacity
    color: list[Array]  # channels, or coefficients

    @staticmethod
    def load(inputs: Inputs, color_width: int, i: Array) -> Gaussian3D:
        """Read the Gaussians ``i``."""
        F = inputs.float_type
        m, geometry = load_vector(inputs.means, i), inputs.geometry.load(i)
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

    def store(self, grad: Gaussian3D, grad_u: Vec2, i: Array) -> None:
        """Write the gradients of the Gaussians ``i``, without the colours'."""
        store_vector(self.means, grad.m, i)
        self.geometry.store(grad.geometry, i)
        packets.store_rows(self.u, grad_u, i)
        dr.scatter(self.opacities, grad.o, i, mode=dr.ReduceMode.NoConflicts)


# Share of the picture's size, beyond each border, up to which a pinhole's J follows the mean:
# gsplat's 0.3 tan(fov / 2), which is 0.15 of the size.
HELD_MARGIN = 0.15


@dataclass(frozen=True)
class CameraArrays:
    """A camera, or its tangent, as arrays of size one: another pose needs no other kernel.

    R, t, o are the rotation, the translation and the position: ``x = R m + t``, ``R o + t = 0``.
    """

    R: Mat3
    t: Vec3
    f: Vec2  # px
    c: Vec2  # px
    o: Vec3  # world
    low: Vec2  # least w of ``held``, px
    high: Vec2  # greatest
    near: Array  # least depth of a Gaussian that is drawn, m
    far: Array  # greatest, m
    blur: Array  # added to the diagonal of the covariances in the picture, px^2
    radius: Array  # Gaussians that reach no further are not drawn, px; negative draws all
    model: CameraModel

    def to(self, F: type) -> CameraArrays:
        """Convert to another precision, inside a kernel."""
        vectors = (self.R, self.t, self.f, self.c, self.o, self.low, self.high)
        cut_offs = (self.near, self.far, self.blur, self.radius)
        return CameraArrays(*(each(F, v) for v in vectors), *map(F, cut_offs), self.model)


def camera_arrays(camera: Camera, options: SplatOptions) -> CameraArrays:
    """Return the camera and the cut-offs that may change from call to call, float64, evaluated."""
    f, c = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    size = np.array([camera.width, camera.height])
    T = camera.T_camera_world
    margin = HELD_MARGIN if options.hold_jacobian else np.inf
    low, high = -margin * size - c, (1 + margin) * size - c
    radius = options.radius_min if options.radius_min > 0 else -1
    reach = np.array([options.near, options.far, options.blur, radius])
    parts = [T[:3, :3].ravel(), T[:3, 3], f, c, camera.position, low, high, reach]
    return _arrays(parts, camera.model)


def camera_tangent(camera: Camera, dT: np.ndarray, dK: np.ndarray) -> CameraArrays:
    """Tangent of :func:`camera_arrays` along tangents of T_camera_world (4, 4) and K (3, 3)."""
    T = camera.T_camera_world
    dR, dt, dc = dT[:3, :3], dT[:3, 3], dK[:2, 2]
    do = -np.linalg.solve(T[:3, :3], dR @ camera.position + dt)
    parts = [dR.ravel(), dt, dK.diagonal()[:2], dc, do, -dc, -dc, np.zeros(4)]
    return _arrays(parts, camera.model)


def camera_adjoint(camera: Camera, grad: CameraGradient) -> tuple[np.ndarray, np.ndarray]:
    """Return the gradients of ``T_camera_world`` and ``K``, given those of R, t, f, c, o."""
    T = camera.T_camera_world
    go = -np.linalg.solve(T[:3, :3].T, grad.o)
    grad_T, grad_K = np.zeros((4, 4)), np.zeros((3, 3))
    grad_T[:3, :3] = np.reshape(grad.R, (3, 3)) + np.outer(go, camera.position)
    grad_T[:3, 3] = grad.t + go
    grad_K[0, 0], grad_K[1, 1] = grad.f
    grad_K[:2, 2] = grad.c
    return grad_T, grad_K


def _arrays(parts: list[np.ndarray], model: CameraModel) -> CameraArrays:
    numbers = np.concatenate(parts)
    array = Float64(numbers)
    x = [dr.gather(Float64, array, k) for k in range(numbers.size)]
    dr.eval(x)
    t, f, c, o, low, high = x[9:12], x[12:14], x[14:16], x[16:19], x[19:21], x[21:23]
    return CameraArrays(
        Mat3.of(x[:9]),
        Vec3(*t),
        Vec2(*f),
        Vec2(*c),
        Vec3(*o),
        Vec2(*low),
        Vec2(*high),
        *x[23:],
        model,
    )
