"""The reference implementation: the same picture in dense float64 torch, with autograd gradients.

It shares no code with the kernels, only constants and records, and is written to be obviously
right: every Gaussian meets every pixel, one after the other; nothing is tiled or pre-scaled. Use it
to check the kernels (:mod:`gva_mi.gradcheck`), on small pictures.

    Sigma = M S S M^T,   Sigma' = J R Sigma R^T J^T + blur I,   J = du/dx by autograd
    alpha = min(alpha_max, o exp(-d^T Sigma'^-1 d / 2))
    antialiased: o sqrt(det(Sigma' - blur I) / det Sigma') replaces o
    color = sum_i T_i alpha_i c_i + T background

The sources are those of the kernels (:mod:`gva_mi.splat.kernels`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

from gva_mi.core.cpu import sqrt
from gva_mi.splat.camera import Camera, CameraModel
from gva_mi.splat.gaussians import Gaussians, Image
from gva_mi.splat.options import SplatOptions

DEPTH_TIE = 2**-22  # relative distance of depths that may swap: four roundings of float32


def render(
    gaussians: Gaussians,
    camera: Camera,
    options: SplatOptions | None = None,
    background: Tensor | None = None,
) -> Image:
    """Draw ``gaussians``, torch tensors of any precision, as ``splat.render`` does, in float64.

    Differentiable, by the camera too if it is made from tensors; the background (D,) is black if
    None.

    Example:
        >>> from gva_mi.splat import render as kernels
        >>> from gva_mi.splat.scene import random_scene
        >>> scene = random_scene(torch.Generator().manual_seed(0), gaussians=8, width=8, height=8)
        >>> expected = render(scene.gaussians, scene.camera).color
        >>> float((kernels(scene.gaussians, scene.camera).color - expected).abs().max()) < 1e-9
        True
    """
    return _render(gaussians, camera, options or SplatOptions(), background)[0]


def threshold_band(
    gaussians: Gaussians,
    camera: Camera,
    options: SplatOptions | None = None,
    alpha: float = 1e-4,
    transmittance: float = 1e-3,
) -> Tensor:
    """Find pixels that may change by a step when the last digits do, (H, W) bool.

    A pixel counts where two consecutive Gaussians have depths relatively nearer than
    :data:`DEPTH_TIE` and not equal, because they may change places; and near a cut-off:

    Args:
        gaussians: torch tensors.
        camera: the view.
        options: cut-offs.
        alpha: a pixel counts where a Gaussian's alpha is relatively nearer to ``alpha_min`` or
            ``alpha_max`` than this.
        transmittance: relative distance of T to ``transmittance_min`` below which a pixel counts.

    Example:
        >>> from gva_mi.splat.scene import random_scene
        >>> scene = random_scene(torch.Generator().manual_seed(0), gaussians=8, width=8, height=8)
        >>> int(threshold_band(scene.gaussians, scene.camera, alpha=0.05).sum())  # of 64 pixels
        4
    """
    with torch.no_grad():
        margins = _render(gaussians, camera, options or SplatOptions(), None)[1]
    return (margins.alpha < alpha) | (margins.rest < transmittance) | (margins.depth < DEPTH_TIE)


class _Margins(NamedTuple):
    """Relative distances of each pixel to the nearest step of its picture, (H, W)."""

    alpha: Tensor  # of any alpha to alpha_min or alpha_max
    rest: Tensor  # of any T to transmittance_min
    depth: Tensor  # between neighbours in depth


def _matrices(camera: Camera) -> tuple[Tensor, Tensor]:
    """Return T_camera_world (4, 4) and K (3, 3), float64; the camera's tensors if given."""
    T, K = camera.tensors
    T = torch.tensor(camera.T_camera_world) if T is None else T.to(torch.float64)
    return T, torch.tensor(camera.K) if K is None else K.to(torch.float64)


def _render(
    gaussians: Gaussians, camera: Camera, options: SplatOptions, background: Tensor | None
) -> tuple[Image, _Margins]:
    T_camera_world, K = _matrices(camera)
    to64 = lambda t: t.to(torch.float64)
    means, opacities = map(to64, (gaussians.means, gaussians.opacities))
    covariances = covariances_of(gaussians)
    R, t = T_camera_world[:3, :3], T_camera_world[:3, 3]
    H, W = camera.height, camera.width
    grid = torch.meshgrid(torch.arange(W) + 0.5, torch.arange(H) + 0.5, indexing="xy")
    pixels = torch.stack(grid, dim=-1).to(torch.float64)  # (H, W, 2)

    colors = _colors(gaussians, means, position=-torch.linalg.solve(R, t))
    background = torch.zeros(colors.shape[1]) if background is None else background

    x = means @ R.T + t
    depths = x[:, 2]
    order = torch.argsort(depths.detach(), stable=True)
    visible = (depths >= options.near) & (depths <= options.far)

    remaining = torch.ones(H, W, dtype=torch.float64)
    stopped = torch.zeros(H, W, dtype=torch.bool)
    color = torch.zeros(H, W, colors.shape[1], dtype=torch.float64)
    depth = torch.zeros(H, W, dtype=torch.float64)
    never = torch.full((H, W), torch.inf, dtype=torch.float64)
    steps, last = _Margins(never, never, never), -never  # last: the depth in front, (H, W)
    off = lambda value, cut: (value.detach() / cut - 1).abs() if cut else never
    nearer = lambda known, where, value: torch.minimum(known, torch.where(where, value, torch.inf))
    for i in order[visible[order]].tolist():
        mean2d, sharp = project(x[i], covariances[i], R, camera, K, options.hold_jacobian)
        covariance = sharp + options.blur * torch.eye(2, dtype=torch.float64)
        opacity = opacities[i]
        if options.antialiased:
            opacity = opacity * sqrt(torch.linalg.det(sharp) / torch.linalg.det(covariance))
        d = pixels - mean2d
        exponent = -0.5 * torch.einsum("hwi,ij,hwj->hw", d, torch.linalg.inv(covariance), d)
        free = opacity * torch.exp(exponent)
        seen = ~stopped & (free.detach() >= options.alpha_min)
        clamped = torch.clamp(free, max=options.alpha_max)
        alpha = torch.where(free >= options.alpha_min, clamped, 0.0)
        rest = remaining * (1 - alpha)

        gap = 1 - last / depths[i].detach()
        to_cut = torch.minimum(off(free, options.alpha_min), off(free, options.alpha_max))
        steps = _Margins(
            nearer(steps.alpha, ~stopped, to_cut),
            nearer(steps.rest, seen, off(rest, options.transmittance_min)),
            nearer(steps.depth, seen & (gap > 0), gap),
        )
        last = torch.where(seen, depths[i].detach(), last)

        stopped = stopped | (rest.detach() <= options.transmittance_min)
        weight = torch.where(stopped, 0.0, remaining * alpha)
        color = color + weight[..., None] * colors[i]
        depth = depth + weight * depths[i]
        remaining = torch.where(stopped, remaining, rest)
    color = color + remaining[..., None] * background
    return Image(color, 1 - remaining, depth if options.depth else None), steps


def covariances_of(gaussians: Gaussians) -> list[Tensor]:
    """Return Sigma = M S S M^T (3, 3) of each Gaussian, square metres (paper, Eq. 1).

    Example:
        >>> from gva_mi.splat.scene import random_scene
        >>> g = random_scene(torch.Generator().manual_seed(0), gaussians=1).gaussians
        >>> round(float(covariances_of(g)[0].det().sqrt() / g.scales.prod()), 6)
        1.0
    """
    if gaussians.covars is not None:
        rows = ((0, 1, 2), (1, 3, 4), (2, 4, 5))
        given = gaussians.covars.to(torch.float64)
        return [torch.stack([torch.stack([c[k] for k in row]) for row in rows]) for c in given]
    axes = zip(gaussians.quats.to(torch.float64), gaussians.scales.to(torch.float64), strict=True)
    stretched = [rotation(quat) @ torch.diag(scale) for quat, scale in axes]
    return [A @ A.T for A in stretched]


def _colors(gaussians: Gaussians, means: Tensor, position: Tensor) -> Tensor:
    """Return the colours (N, D) as seen from the camera's position (3,)."""
    if gaussians.sh is None:
        return gaussians.colors.to(torch.float64)
    toward = means - position
    basis = harmonics(toward / toward.norm(dim=1, keepdim=True), gaussians.sh.shape[1])
    sums = torch.einsum("nk,nkc->nc", basis, gaussians.sh.to(torch.float64))
    return torch.clamp(sums + 0.5, min=0)


def project(
    x: Tensor, covariance: Tensor, R: Tensor, camera: Camera, K: Tensor, hold: bool = True
) -> tuple[Tensor, Tensor]:
    """Project one Gaussian at ``x`` in camera space: mean (2,), covariance (2, 2) before blur.

    This is EWA splatting (Zwicker et al. 2001; paper, Eq. 2), with R of the camera, its matrix K,
    and J held at the picture's border as in gsplat if ``hold``.

    Example:
        >>> camera = Camera(100.0, 100.0, 32.0, 24.0, torch.eye(4).numpy(), 64, 48)
        >>> x, K = torch.tensor([0.0, 0.1, 2.0]).double(), torch.tensor(camera.K)
        >>> Sigma, R = 0.01 * torch.eye(3).double(), torch.eye(3).double()
        >>> [part.round(decimals=2).tolist() for part in project(x, Sigma, R, camera, K)]
        [[32.0, 29.0], [[25.0, 0.0], [0.0, 25.06]]]
    """
    falls = lambda x: picture_point(x, K, camera.model)
    J = torch.func.jacrev(falls)(x)
    if camera.model == "pinhole" and hold:
        # gsplat: J follows the mean up to 15 % of the picture's size beyond its border
        size = torch.tensor([camera.width, camera.height], dtype=torch.float64)
        u = falls(x)
        held = torch.minimum(torch.maximum(u, -0.15 * size), 1.15 * size)
        J = torch.cat([J[:, :2], -(held - K[:2, 2])[:, None] / x[2]], dim=1)
    B = J @ R
    return falls(x), B @ covariance @ B.T


def picture_point(x: Tensor, K: Tensor, model: CameraModel) -> Tensor:
    """Project a point (3,) of camera space into the picture, (2,) px (camera.py).

    Example:
        >>> x, K = torch.tensor([1.0, 0, 1]), torch.tensor([[10.0, 0, 5], [0, 10, 5], [0, 0, 1]])
        >>> [round(float(picture_point(x, K, m)[0]), 2) for m in ("pinhole", "fisheye")]  # 45°
        [15.0, 12.85]
    """
    if model == "pinhole":
        p = x[:2] / x[2]
    elif model == "ortho":
        p = x[:2]
    elif model == "fisheye":
        r = x[:2].norm()
        p = x[:2] * torch.atan2(r, x[2]) / r
    else:
        raise ValueError(f"picture_point: unknown camera model {model!r}")
    return torch.diagonal(K)[:2] * p + K[:2, 2]


def rotation(quat: Tensor) -> Tensor:
    """Return the rotation matrices (..., 3, 3) of quaternions (..., 4) wxyz of any length.

    The rotation of zero is the identity.

    Example:
        >>> (rotation(torch.tensor([1.0, 0, 0, 1])) @ torch.tensor([1.0, 0, 0])).round().tolist()
        [0.0, 1.0, 0.0]
    """
    length = quat.norm(dim=-1, keepdim=True)
    w, x, y, z = (quat / length.where(length > 0, 1)).unbind(-1)
    zero = torch.zeros_like(w)
    K = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).unflatten(-1, (3, 3))
    identity = torch.eye(3, dtype=quat.dtype)
    return identity + 2 * w[..., None, None] * K + 2 * K @ K  # Rodrigues, with half angles


def harmonics(directions: Tensor, count: int) -> Tensor:
    """Evaluate the first ``count`` real spherical harmonics at unit vectors (N, 3): (N, count).

    Order and sign are those of 3DGS. The recurrences of the associated Legendre functions have
    nothing in common with the kernels' polynomials.

    Example:
        >>> harmonics(torch.tensor([[0.0, 0, 1]]).double(), 4).round(decimals=4).tolist()
        [[0.2821, -0.0, 0.4886, -0.0]]
    """
    degrees = [(l, m) for l in range(int(count**0.5)) for m in range(-l, l + 1)]
    return torch.stack([_harmonic(l, m, *directions.unbind(1)) for l, m in degrees], dim=1)


def _harmonic(l: int, m: int, x: Tensor, y: Tensor, z: Tensor) -> Tensor:
    """Y_lm = N_lm P_l^|m|(z) / sin^|m| · Re or Im of (x + i y)^|m|."""
    k = abs(m)
    real, imaginary = torch.ones_like(x), torch.zeros_like(x)
    for _ in range(k):
        real, imaginary = real * x - imaginary * y, real * y + imaginary * x
    # P_k^k / sin^k with the Condon-Shortley sign (-1)^k, then upwards in the degree
    double_factorial = float(math.prod(range(-1, -2 * k, -2)))
    previous, current = torch.zeros_like(z), torch.full_like(z, double_factorial)
    for degree in range(k + 1, l + 1):
        following = ((2 * degree - 1) * z * current - (degree + k - 1) * previous) / (degree - k)
        previous, current = current, following
    factorials = math.perm(l + k, 2 * k)  # (l + k)! / (l - k)!
    norm = ((2 * l + 1) / (4 * torch.pi * factorials)) ** 0.5
    if m == 0:
        return norm * current
    return 2**0.5 * norm * current * (real if m > 0 else imaginary)
