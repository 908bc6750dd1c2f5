"""What gsplat's call costs beside ``render``: the same picture and the same gradients by both."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from gva_mi.splat.bench.timing import Timing, Work, by_turns
from gva_mi.splat.gsplat_compat import rasterization


@dataclass(frozen=True)
class Doors:
    """Forward and backward passes of colour and alpha, without a depth."""

    gaussians: int
    render: Timing
    rasterization: Timing
    packed: Timing  # rasterization with gsplat's default, rows of those in the picture
    ratio: float  # of the medians of each call's time and its neighbour's: rasterization / render
    ratio_packed: float

    def line(self) -> str:
        """For the table of all figures."""
        return (
            f"gsplat's call, rasterization(), of {self.gaussians:,} Gaussians: {self.ratio:.2f} x "
            f"render()'s time, packed {self.ratio_packed:.2f} x ({self.render.least:.2f} ms at "
            "least, without a depth)"
        )


def measure_doors(work: Work, calls: int) -> Doors:
    """Measure the calls by turns, so that the machine's other work falls on all."""
    scene = replace(work.scene, options=replace(work.scene.options, depth=False))
    plain, dtype = Work(scene, work.weights), scene.gaussians.means.dtype
    T_camera_world, K = scene.camera.T_camera_world, scene.camera.K
    matrices = tuple(torch.tensor(numbers, dtype=dtype)[None] for numbers in (T_camera_world, K))
    call = lambda packed: lambda: _rasterize(plain, matrices, packed)
    ways = (plain.both, call(False), call(True))
    timings, beside = by_turns(ways, calls)
    return Doors(len(scene.gaussians), *timings, *beside[1:])


def _rasterize(work: Work, matrices: tuple[Tensor, Tensor], packed: bool) -> None:
    """What ``Work.both`` does, by gsplat's call, with ``means2d.grad`` kept as densifiers do."""
    s, g, camera = work.scene, work.scene.gaussians, work.scene.camera
    colors, degree = (g.colors, None) if g.sh is None else (g.sh, int(g.sh.shape[1] ** 0.5) - 1)
    pictures, _, meta = rasterization(
        g.means,
        g.quats,
        g.scales,
        g.opacities,
        colors,
        *matrices,
        camera.width,
        camera.height,
        sh_degree=degree,
        packed=packed,
        backgrounds=s.background[None],
        camera_model=camera.model,
    )
    meta["means2d"].retain_grad()
    torch.autograd.grad(pictures, [*g.arrays().values(), s.background], work.weights[None])
