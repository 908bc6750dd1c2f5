"""The camera as the kernels take it, with its tangent and adjoint."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import numpy as np
from drjit import ArrayBase as Array
from drjit.llvm import Float64

from gva_mi.splat.camera import Camera, CameraModel
from gva_mi.splat.kernels.records import CameraGradient
from gva_mi.splat.options import SplatOptions

MARGIN = 0.15  # of the picture's size, on each side, where a pinhole's J still follows the mean


@dataclass(frozen=True)
class CameraArrays:
    """A camera, or its tangent, as arrays of size one: another pose needs no other kernel.

    R, t, o are the rotation, the translation and the position: ``x = R m + t``, ``R o + t = 0``.
    """

    R: list[Array]  # 9, row by row
    t: list[Array]  # 3
    f: list[Array]  # 2, px
    c: list[Array]  # 2, px
    o: list[Array]  # 3, world
    low: list[Array]  # 2, least w of ``held``, px
    high: list[Array]  # 2, greatest
    near: Array  # least depth of a Gaussian that is drawn, m
    far: Array  # greatest, m
    blur: Array  # added to the diagonal of the covariances in the picture, px^2
    radius: Array  # Gaussians that reach no further are not drawn, px; negative draws all
    model: CameraModel

    def to(self, F: type) -> CameraArrays:
        """Convert to another precision, inside a kernel."""
        lists = (self.R, self.t, self.f, self.c, self.o, self.low, self.high)
        cut_offs = (self.near, self.far, self.blur, self.radius)
        return CameraArrays(
            *([F(x) for x in part] for part in lists), *map(F, cut_offs), self.model
        )


def camera_arrays(camera: Camera, options: SplatOptions) -> CameraArrays:
    """Return the camera and the cut-offs that may change from call to call, float64, evaluated."""
    f, c = np.array([camera.fx, camera.fy]), np.array([camera.cx, camera.cy])
    size = np.array([camera.width, camera.height])
    T = camera.T_camera_world
    low, high = -MARGIN * size - c, (1 + MARGIN) * size - c
    radius = options.radius_min if options.radius_min > 0 else -1
    reach = np.array([options.near, options.far, options.blur, radius])
    parts = [T[:3, :3].ravel(), T[:3, 3], f, c, camera.position, low, high, reach]
    return _arrays(parts, camera.model)


def camera_tangent(camera: Camera, dT: np.ndarray, dK: np.ndarray) -> CameraArrays:
    """Tangent of :func:`camera_arrays` along those of T_camera_world (4, 4) and K (3, 3)."""
    T = camera.T_camera_world
    dR, dt, dc = dT[:3, :3], dT[:3, 3], dK[:2, 2]
    do = -np.linalg.solve(T[:3, :3], dR @ camera.position + dt)
    parts = [dR.ravel(), dt, dK.diagonal()[:2], dc, do, -dc, -dc, np.zeros(4)]
    return _arrays(parts, camera.model)


def camera_adjoint(camera: Camera, grad: CameraGradient) -> tuple[np.ndarray, np.ndarray]:
    """Convert the gradient by R, t, f, c, o to those by ``T_camera_world`` and ``K``."""
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
    return CameraArrays(
        x[:9], x[9:12], x[12:14], x[14:16], x[16:19], x[19:21], x[21:23], *x[23:], model
    )
