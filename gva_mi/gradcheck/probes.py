"""Directions in an input's space, and an image's derivative along them.

With the weights w of a loss <w, image>, <w, J v> = <J^T w, v> ties a derivative J v along a
direction v to the gradient J^T w.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Generator, Tensor
from torch.autograd import forward_ad

from gva_mi.splat.camera import Camera
from gva_mi.splat.gaussians import Gaussians, Image
from gva_mi.splat.options import SplatOptions
from gva_mi.splat.scene import Scene

# A function from Gaussians, camera, options and background (D,) to images, as ``splat.render``.
Renderer = Callable[[Gaussians, Camera, SplatOptions, Tensor], Image]
Tensors = dict[str, Tensor]

IMAGES = ("color", "alpha", "depth")  # the last one where SplatOptions.depth is on


def images_of(scene: Scene) -> tuple[str, ...]:
    """Return the names of the images that the scene's options ask for.

    Example:
        >>> from dataclasses import replace
        >>> from gva_mi.gradcheck import random_scene
        >>> scene = random_scene(Generator().manual_seed(0))
        >>> images_of(scene), images_of(replace(scene, options=SplatOptions(depth=False)))
        (('color', 'alpha', 'depth'), ('color', 'alpha'))
    """
    return IMAGES if scene.options.depth else IMAGES[:2]


def drawn(fn: Renderer, scene: Scene, inputs: Tensors) -> list[Tensor]:
    """Render the scene with other inputs; return its images.

    Example:
        >>> from gva_mi.gradcheck import random_scene
        >>> from gva_mi.splat import render
        >>> scene = random_scene(Generator().manual_seed(0), gaussians=8, width=16, height=16)
        >>> inputs = scene.inputs() | {"opacities": torch.zeros(8).double()}
        >>> color, alpha, depth = drawn(render, scene, inputs)
        >>> float(alpha.max())
        0.0
    """
    moved = scene.with_inputs(inputs)
    image = fn(moved.gaussians, moved.camera, moved.options, moved.background)
    return [getattr(image, name) for name in images_of(scene)]


def leaves(values: Tensors, dtype: torch.dtype = torch.float64) -> Tensors:
    """Return copies of tensors in one precision that require gradients.

    Example:
        >>> leaves({"means": torch.zeros(2)})
        {'means': tensor([0., 0.], dtype=torch.float64, requires_grad=True)}
    """
    return {k: v.detach().to(dtype).clone().requires_grad_() for k, v in values.items()}


def gradients(made: Iterable[Tensor], leaves: Tensors, grads: Iterable[Tensor]) -> Tensors:
    """Return the gradients with respect to leaves, by name; zero where a leaf was not used.

    Args:
        made: outputs; those that depend on no leaf count as constants.
        leaves: inputs that need gradients.
        grads: the loss's gradient with respect to each output.

    Example:
        >>> inputs = leaves({"x": torch.tensor([3.0]), "unused": torch.tensor([5.0])})
        >>> found = gradients([inputs["x"] ** 2], inputs, [torch.ones(1).double()])
        >>> {name: gradient.item() for name, gradient in found.items()}
        {'x': 6.0, 'unused': 0.0}
    """
    pairs = [(x, g) for x, g in zip(made, grads, strict=True) if x.requires_grad]
    if not pairs:
        raise ValueError("gradcheck(): no image has a gradient; is the renderer differentiable?")
    outputs, weights = zip(*pairs, strict=True)
    found = torch.autograd.grad(outputs, list(leaves.values()), weights, allow_unused=True)
    zero = lambda g, v: torch.zeros_like(v) if g is None else g
    return {k: zero(g, v) for (k, v), g in zip(leaves.items(), found, strict=True)}


def tangents(
    fn: Callable[[Tensors], Sequence[Tensor]], values: Tensors, name: str, direction: Tensor
) -> list[Tensor]:
    """Return J v of every output as one value moves along ``direction``, by forward-mode AD.

    Example:
        >>> squares = lambda values: [values["x"] ** 2]
        >>> tangents(squares, {"x": torch.tensor([1.0, 3.0])}, "x", torch.tensor([0.0, 1.0]))
        [tensor([0., 6.])]
    """
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
    order: int = 4,
) -> list[Tensor]:
    """Return J v of every output by central differences; those of order 4 reach two steps far.

    Order 2: (f(h) - f(-h)) / 2 h. Order 4: (8 (f(h) - f(-h)) - (f(2 h) - f(-2 h))) / 12 h.
    Their errors are of these orders in h (Fornberg, "Generation of Finite Difference Formulas on
    Arbitrarily Spaced Grids", 1988, table 1).

    Example:
        The derivative of x³ at 1 is 3; order 4 is exact up to x⁴.

        >>> cubes, x = lambda values: [values["x"] ** 3], {"x": torch.ones(1).double()}
        >>> found = [differences(cubes, x, "x", torch.ones(1), 0.1, order) for order in (2, 4)]
        >>> [round(tangent.item(), 6) for (tangent,) in found]
        [3.01, 3.0]
    """
    still = {k: v.detach() for k, v in values.items()}
    at = lambda x: fn(still | {name: still[name] + x * direction})
    near = [a - b for a, b in zip(at(step), at(-step), strict=True)]
    if order == 2:
        return [d / (2 * step) for d in near]
    far = [a - b for a, b in zip(at(2 * step), at(-2 * step), strict=True)]
    return [(8 * d - e) / (12 * step) for d, e in zip(near, far, strict=True)]


def tangent_image(fn: Renderer, scene: Scene, name: str, direction: Tensor) -> Image:
    """Return J v of the image as one input moves along ``direction``, by forward-mode AD.

    Example:
        >>> from gva_mi.gradcheck import random_scene
        >>> from gva_mi.splat import render
        >>> scene = random_scene(Generator().manual_seed(0), gaussians=8, width=16, height=16)
        >>> tangent_image(render, scene, "means", torch.ones(8, 3)).color.shape
        torch.Size([16, 16, 3])
    """
    return Image(*tangents(lambda x: drawn(fn, scene, x), scene.inputs(), name, direction))


def difference_image(
    fn: Renderer, scene: Scene, name: str, direction: Tensor, step: float = 1e-6
) -> Image:
    """Return J v of the image by a central difference of ``step`` times ``direction``.

    Example:
        >>> from gva_mi.gradcheck import random_scene
        >>> from gva_mi.splat import render
        >>> scene = random_scene(Generator().manual_seed(0), gaussians=8, width=16, height=16)
        >>> scene, right = scene.to(torch.float64), torch.ones(8, 3).double()
        >>> by_difference = difference_image(render, scene, "means", right).color
        >>> off = by_difference - tangent_image(render, scene, "means", right).color
        >>> off.abs().max() < 1e-8
        tensor(True)
    """
    images = lambda inputs: drawn(fn, scene, inputs)
    return Image(*differences(images, scene.inputs(), name, direction, step, order=2))


@dataclass(frozen=True)
class Probe:
    """The directions in which an input is moved: one through all entries, then single entries.

    Example:
        >>> gradient = torch.arange(6.0).double()
        >>> probe = Probe.among(gradient, entries=2, generator=Generator().manual_seed(0))
        >>> probe.entries, probe.along(gradient)[1:]  # derivatives along two entries
        (((2,), (1,)), tensor([2., 1.], dtype=torch.float64))
    """

    everywhere: Tensor  # of the input's shape, of length one half to one
    entries: tuple[tuple[int, ...], ...]

    @staticmethod
    def among(gradient: Tensor, entries: int, generator: Generator) -> Probe:
        """Draw a direction, and choose the entries with the greatest gradients of a random half."""
        direction = torch.randn(gradient.shape, generator=generator).double()
        half = torch.rand(gradient.numel(), generator=generator) < 0.5
        chosen = (gradient.reshape(-1).abs() * half).topk(min(entries, gradient.numel())).indices
        at = [tuple(int(i) for i in torch.unravel_index(k, gradient.shape)) for k in chosen]
        # divided by a power of two and not by the norm, the numbers are the same in float32
        length = 2.0 ** torch.log2(direction.norm().clamp(min=1)).ceil()
        return Probe(direction / length, tuple(at))

    def directions(self) -> Iterator[Tensor]:
        """Yield all directions, each of the input's shape."""
        yield self.everywhere
        for index in self.entries:
            single = torch.zeros_like(self.everywhere)
            single[index] = 1
            yield single

    def along(self, gradient: Tensor) -> Tensor:
        """Return <gradient, v> for every direction v."""
        return torch.stack([(gradient * v).sum() for v in self.directions()])
