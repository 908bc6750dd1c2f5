"""Directions in an input's space, and an image's derivative along them.

With the weights w of a loss <w, image>, <w, J v> = <J^T w, v> ties a derivative J v along a
direction v to the gradient J^T w.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Generator, Tensor
from torch.autograd import forward_ad

from gva_mi.splat.camera import Camera
from gva_mi.splat.gaussians import Gaussians, Image
from gva_mi.splat.options import SplatOptions
from gva_mi.splat.scene import Scene

Renderer = Callable[[Gaussians, Camera, SplatOptions, Tensor], Image]
Tensors = dict[str, Tensor]

IMAGES = ("color", "alpha", "depth")  # the last one where SplatOptions.depth is on


def images_of(scene: Scene) -> tuple[str, ...]:
    """Return the names of the images that the scene's options ask for."""
    return IMAGES if scene.options.depth else IMAGES[:2]


def draw(fn: Renderer, scene: Scene) -> Image:
    """Render the scene."""
    return fn(scene.gaussians, scene.camera, scene.options, scene.background)


def loss(image: Image, weights: Tensor) -> Tensor:
    """Return <w, image>, summed in float64 so that the sum adds no error of its own.

    Args:
        image: of any precision.
        weights: (H, W, D + 2), for the colour's channels, alpha and depth.
    """
    color = (image.color.double() * weights[..., :-2]).sum()
    total = color + (image.alpha.double() * weights[..., -2]).sum()
    if image.depth is None:
        return total
    return total + (image.depth.double() * weights[..., -1]).sum()


def gradients(
    made: Sequence[Tensor], leaves: Tensors, grads: Sequence[Tensor] | None = None
) -> Tensors:
    """Return the gradients by leaves, by their names; zero where a leaf was not used."""
    found = torch.autograd.grad(made, list(leaves.values()), grads, allow_unused=True)
    zero = lambda g, v: torch.zeros_like(v) if g is None else g
    return {k: zero(g, v) for (k, v), g in zip(leaves.items(), found, strict=True)}


def tangents(
    fn: Callable[[Tensors], Sequence[Tensor]], values: Tensors, name: str, direction: Tensor
) -> list[Tensor]:
    """Return J v of every output as one value moves along ``direction``, by forward-mode AD."""
    still = {k: v.detach() for k, v in values.items()}
    with forward_ad.dual_level():
        moving = forward_ad.make_dual(still[name], direction.to(still[name].dtype))
        parts = [forward_ad.unpack_dual(x) for x in fn(still | {name: moving})]
        return [torch.zeros_like(p.primal) if p.tangent is None else p.tangent for p in parts]


@torch.no_grad()
def differences(
    fn: Callable[[Tensors], Sequence[Tensor]],
    values: Tensors,
    name: str,
    direction: Tensor,
    step: float,
) -> list[Tensor]:
    """Return J v of every output, (8 (f(h) - f(-h)) - (f(2 h) - f(-2 h))) / 12 h: fourth order."""
    still = {k: v.detach() for k, v in values.items()}
    at = lambda x: fn(still | {name: still[name] + x * direction})
    ends = (at(step), at(-step), at(2 * step), at(-2 * step))
    return [(8 * (a - b) - (c - d)) / (12 * step) for a, b, c, d in zip(*ends, strict=True)]


def tangent_image(fn: Renderer, scene: Scene, name: str, direction: Tensor) -> Image:
    """Return J v of the image as one input moves along ``direction``, by forward-mode AD."""

    def images(inputs: Tensors) -> list[Tensor]:
        image = draw(fn, scene.with_inputs(inputs))
        return [getattr(image, k) for k in images_of(scene)]

    return Image(*tangents(images, scene.inputs(), name, direction))


def difference_image(
    fn: Renderer, scene: Scene, name: str, direction: Tensor, step: float = 1e-6
) -> Image:
    """Return J v of the image by a central difference of ``step`` times ``direction``."""
    inputs = {k: v.detach() for k, v in scene.inputs().items()}
    ends = []
    for sign in (1, -1):
        moved = inputs | {name: inputs[name] + sign * step * direction}
        ends.append(draw(fn, scene.with_inputs(moved)))
    slope = lambda k: (getattr(ends[0], k) - getattr(ends[1], k)) / (2 * step)
    return Image(*(slope(k) for k in images_of(scene)))


@dataclass(frozen=True)
class Probe:
    """The directions in which an input is moved: one through all entries, then single entries."""

    everywhere: Tensor  # of the input's shape, of length one half to one
    entries: tuple[tuple[int, ...], ...]

    @staticmethod
    def among(gradient: Tensor, entries: int, generator: Generator) -> Probe:
        """A random direction, and the entries with the greatest gradients of a random half."""
        direction = torch.randn(gradient.shape, generator=generator).double()
        half = torch.rand(gradient.numel(), generator=generator) < 0.5
        chosen = (gradient.reshape(-1).abs() * half).topk(min(entries, gradient.numel())).indices
        at = [tuple(int(i) for i in torch.unravel_index(k, gradient.shape)) for k in chosen]
        # divided by a power of two and not by the norm, the numbers are the same in float32
        length = 2.0 ** torch.log2(direction.norm().clamp(min=1)).ceil()
        return Probe(direction / length, tuple(at))

    def directions(self) -> Iterator[Tensor]:
        """All directions, each of the input's shape."""
        yield self.everywhere
        for index in self.entries:
            single = torch.zeros_like(self.everywhere)
            single[index] = 1
            yield single

    def along(self, gradient: Tensor) -> Tensor:
        """Return <gradient, v> for every direction v."""
        return torch.stack([(gradient * v).sum() for v in self.directions()])
