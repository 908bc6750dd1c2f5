"""The image's derivative as one input moves: by the renderer's tangent, and by differences.

Both return an image, J v, for a direction v in the space of one input; with the weights w of a
loss, <w, J v> = <J^T w, v> ties them to the adjoint.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
from torch import Generator, Tensor
from torch.autograd import forward_ad

from gva_mi.splat.camera import Camera
from gva_mi.splat.gaussians import Gaussians, Image
from gva_mi.splat.gradcheck.verdict import IMAGES
from gva_mi.splat.options import SplatOptions
from gva_mi.splat.scene import Scene

Renderer = Callable[[Gaussians, Camera, SplatOptions, Tensor], Image]


def images_of(scene: Scene) -> tuple[str, ...]:
    """The names of the images that the scene's options ask for."""
    return IMAGES if scene.options.depth else IMAGES[:2]


def draw(fn: Renderer, scene: Scene) -> Image:
    """The scene as the renderer sees it."""
    return fn(scene.gaussians, scene.camera, scene.options, scene.background)


def loss(image: Image, weights: Tensor) -> Tensor:
    """<w, image>, added up in float64 so that the sum adds no error of its own.

    Args:
        image: of any precision.
        weights: (H, W, D + 2), for the colour's channels, alpha and depth.
    """
    color = (image.color.double() * weights[..., :-2]).sum()
    total = color + (image.alpha.double() * weights[..., -2]).sum()
    if image.depth is None:
        return total
    return total + (image.depth.double() * weights[..., -1]).sum()


def tangent_image(fn: Renderer, scene: Scene, name: str, direction: Tensor) -> Image:
    """J v: the image's derivative as one input moves along ``direction``, by forward-mode AD."""
    inputs = {k: v.detach() for k, v in scene.inputs().items()}
    with forward_ad.dual_level():
        moving = forward_ad.make_dual(inputs[name], direction.to(inputs[name].dtype))
        image = draw(fn, scene.with_inputs(inputs | {name: moving}))
        parts = [forward_ad.unpack_dual(getattr(image, k)) for k in images_of(scene)]
        return Image(*(torch.zeros_like(p[0]) if p[1] is None else p[1] for p in parts))


def difference_image(
    fn: Renderer, scene: Scene, name: str, direction: Tensor, step: float = 1e-6
) -> Image:
    """J v by a central difference of ``step`` times ``direction``."""
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
        """All of them, each of the input's shape."""
        yield self.everywhere
        for index in self.entries:
            single = torch.zeros_like(self.everywhere)
            single[index] = 1
            yield single

    def along(self, gradient: Tensor) -> Tensor:
        """<gradient, v> for every direction v."""
        return torch.stack([(gradient * v).sum() for v in self.directions()])
