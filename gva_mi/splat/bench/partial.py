"""What a gradient by some of the inputs costs beside one by all: the rest is not computed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch

from gva_mi.splat.bench.timing import Timing, Work, by_turns
from gva_mi.splat.gaussians import Gaussians
from gva_mi.splat.torch_op import render


@dataclass(frozen=True)
class Partial:
    """Forward and backward passes of the colour, without a depth."""

    all: Timing  # by every input
    colors: Timing  # by the colours, or coefficients, alone
    motion: Timing  # by means and quats alone
    ratio_colors: float  # of the medians of each call's time and its neighbour's
    ratio_motion: float

    def line(self) -> str:
        """For the table."""
        colors = f"the colours alone {self.ratio_colors:.2f} x"
        return f"gradients by {colors}, by means and quats alone {self.ratio_motion:.2f} x all"


def measure_partial(work: Work, calls: int) -> Partial:
    """Measure the calls by turns, so that the machine's other work falls on all."""
    names = list(work.scene.gaussians.arrays())
    some = (names, names[-1:], ["means", "quats"])
    ways = [_pass(work, wanted) for wanted in some]
    timings, beside = by_turns(ways, calls)
    return Partial(*timings, *beside[1:])


def _pass(work: Work, wanted: list[str]) -> Callable[[], None]:
    """A forward and backward pass whose gradients are by the inputs named."""
    scene = work.scene
    options = replace(scene.options, depth=False)
    arrays = {k: v.detach().clone() for k, v in scene.gaussians.arrays().items()}
    leaves = [arrays[name].requires_grad_() for name in wanted]
    gaussians, background = Gaussians(**arrays), scene.background.detach()

    def both() -> None:
        image = render(gaussians, scene.camera, options, background)
        torch.autograd.grad(image.color, leaves, work.weights)

    return both
