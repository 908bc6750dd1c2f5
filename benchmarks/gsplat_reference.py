"""Time gsplat's own torch reference on the CPU beside our renderer, if gsplat is installed.

gsplat renders on CUDA alone. Its torch reference also needs CUDA for two steps, which this module
replaces: the list of (pixel, Gaussian) pairs, made once and not timed, and the products along a
pixel's list, by a cumulative sum of logarithms. The time covers its projection, spherical
harmonics, compositing and torch's backward through them: a lower bound for users of its reference.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from benchmarks.timing import Table, by_turns
from gva_mi.splat import render as our_render
from gva_mi.splat.scene import Scene

SAME_PSNR = 40.0  # dB; chosen: a renderer whose image differs by more does other work


def installed() -> bool:
    """Whether gsplat is installed."""
    return importlib.util.find_spec("gsplat") is not None


def compare(scene: Scene, repeats: int, theirs: Callable[[], Tensor] | None = None) -> Table:
    """Time gsplat's reference and ours in turn, forward and backward, if their images agree.

    Args:
        scene: of float32, with spherical harmonics and a pinhole camera.
        repeats: calls of each.
        theirs: draws the colour (H, W, 3) of the scene; gsplat's reference where None.
    """
    scene = replace(scene, options=replace(scene.options, depth=False))
    g, inputs = scene.gaussians, list(scene.gaussians.arrays().items())
    if theirs is None:
        pairs = _pairs(scene)
        theirs = lambda: render(scene, pairs)
    ours = lambda: our_render(g, scene.camera, scene.options, scene.background).color
    leaves = [v for _, v in inputs]
    expected = ours().detach()
    weights = torch.randn(expected.shape, generator=torch.Generator().manual_seed(0))
    step = lambda draw: torch.autograd.grad(draw(), leaves, weights)
    error = float((theirs().detach().double() - expected.double()).square().mean())
    psnr = -10 * math.log10(max(error, 1e-20))
    if not psnr >= SAME_PSNR:
        title = f"gsplat's torch reference draws another image ({psnr:.1f} dB) and is not timed"
        return Table(title, [{"PSNR dB": psnr}])
    off = [float((a - b).norm() / b.norm()) for a, b in zip(step(theirs), step(ours), strict=True)]
    worst = max(range(len(off)), key=off.__getitem__)
    title = (
        f"gsplat's torch reference, forward and backward ({psnr:.0f} dB; gradients differ by up to "
        f"{off[worst]:.0e}, {inputs[worst][0]})"
    )
    return by_turns(title, {"ours": lambda: step(ours), "gsplat": lambda: step(theirs)}, repeats)


def _project(scene: Scene) -> tuple[Tensor, Tensor, Tensor]:
    """Call gsplat's projection; return means and conics in the picture, and depths."""
    from gsplat.cuda import _torch_impl as theirs

    g, camera = scene.gaussians, scene.camera
    pose = torch.tensor(camera.T_camera_world, dtype=torch.float32)[None]
    K = torch.tensor(camera.K, dtype=torch.float32)[None]
    covariances, _ = theirs._quat_scale_to_covar_preci(g.quats, g.scales, True, False, False)
    _, means2d, depths, conics, _ = theirs._fully_fused_projection(
        g.means, covariances, pose, K, camera.width, camera.height, eps2d=scene.options.blur
    )
    return means2d[0], conics[0], depths[0]


class PixelPairs(NamedTuple):
    """All P pairs of a pixel and a Gaussian with alpha >= alpha_min, by pixel, front to back."""

    pixel: Tensor  # (P,)
    ids: Tensor  # (P,) of the Gaussian
    start: Tensor  # (P,) first pair of the same pixel


def _pairs(scene: Scene) -> PixelPairs:
    """List the pairs of a scene."""
    with torch.no_grad():
        means2d, conics, depths = _project(scene)
    W, H = scene.camera.width, scene.camera.height
    determinant = conics[:, 0] * conics[:, 2] - conics[:, 1] ** 2
    tau = 2 * torch.log(scene.gaussians.opacities.detach() / scene.options.alpha_min)
    reach = torch.sqrt(tau.clamp(min=0) * conics[:, [2, 0]].T / determinant).T
    pixels, ids = [], []
    for i in torch.argsort(depths).tolist():
        if not tau[i] > 0 or depths[i] <= scene.options.near:
            continue
        (x0, y0), (x1, y1) = (means2d[i] - reach[i] - 0.5).ceil(), (means2d[i] + reach[i] + 0.5)
        x = torch.arange(max(0, int(x0)), min(W, int(x1)))
        y = torch.arange(max(0, int(y0)), min(H, int(y1)))
        dx, dy = x + 0.5 - means2d[i, 0], (y + 0.5 - means2d[i, 1])[:, None]
        a, b, c = conics[i]
        inside = a * dx * dx + 2 * b * dx * dy + c * dy * dy <= tau[i]
        found = (y[:, None] * W + x)[inside]
        pixels.append(found)
        ids.append(torch.full_like(found, i))
    pixel, order = torch.sort(torch.cat(pixels), stable=True)
    return PixelPairs(pixel, torch.cat(ids)[order], torch.searchsorted(pixel, pixel))


def render(scene: Scene, pairs: PixelPairs) -> Tensor:
    """Render the colour (H, W, 3) by gsplat's reference."""
    from gsplat.cuda import _torch_impl as theirs

    g, camera, (pixel, ids, start) = scene.gaussians, scene.camera, pairs
    means2d, conics, _ = _project(scene)
    toward = g.means - torch.tensor(camera.position, dtype=torch.float32)
    degree = int(g.sh.shape[1] ** 0.5) - 1
    colors = torch.clamp_min(theirs._spherical_harmonics(degree, toward, g.sh) + 0.5, 0)
    d = torch.stack([pixel % camera.width, pixel // camera.width], dim=-1) + 0.5 - means2d[ids]
    c = conics[ids]
    sigma = 0.5 * (c[:, 0] * d[:, 0] ** 2 + c[:, 2] * d[:, 1] ** 2) + c[:, 1] * d[:, 0] * d[:, 1]
    alpha = torch.clamp_max(g.opacities[ids] * torch.exp(-sigma), scene.options.alpha_max)
    logs = torch.log1p(-alpha).double()
    before = torch.cumsum(logs, dim=0) - logs
    transmittance = torch.exp(before - before[start]).float()
    goes_on = transmittance.detach() * (1 - alpha.detach()) > scene.options.transmittance_min
    weights = torch.where(goes_on, transmittance * alpha, 0.0)
    size = camera.width * camera.height
    image = torch.zeros(size, 3).index_add(0, pixel, weights[:, None] * colors[ids])
    covered = torch.zeros(size).index_add(0, pixel, weights)
    image = image + (1 - covered)[:, None] * scene.background
    return image.view(camera.height, camera.width, 3)
