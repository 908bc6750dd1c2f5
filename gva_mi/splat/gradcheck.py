"""Whether a renderer's gradients are right: independent answers side by side.

For a scalar loss L = <w, image>, with random weights w on colour, alpha and depth, the gradient by
every input is taken

* by the renderer's adjoint in float32 and in float64,
* by the renderer's tangent (torch's forward-mode AD) in both, along a random direction and along
  single entries: <w, J v> is compared with <J^T w, v>,
* by Dr.Jit's own autodiff through a plain loop (autodiff.py), in float64,
* by central differences of the renderer in float64, at a handful of entries,
* by autograd through the slow twin (reference.py), in float64: what the others are compared with.

The image has steps where a pixel's alpha or transmittance crosses a cut-off. Pixels in a narrow
band around them have no weight in the loss, and are counted: there the last digit decides, and no
gradient exists. Every number of the scene is rounded to float32 first, so that both precisions see
the same scene; and the report says how far the true gradient moves when the scene's numbers move
within their last float32 digit, for no float32 renderer can be asked for less.

    report = gradcheck(render, random_scene(torch.Generator().manual_seed(0)))
    assert report.passed, report.table()

``fn`` is any renderer with the signature of ``torch_op.render``: your own kernel, say.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import drjit as dr
import numpy as np
import torch
from drjit.llvm.ad import TensorXf64
from torch import Generator, Tensor
from torch.autograd import forward_ad

from gva_mi.splat import autodiff, reference
from gva_mi.splat.camera import Camera
from gva_mi.splat.gaussians import Gaussians, Image
from gva_mi.splat.options import SplatOptions
from gva_mi.splat.scene import Scene, random_scene
from gva_mi.splat.verdict import IMAGES, Maps, Report, Row

__all__ = [
    "Renderer",
    "Report",
    "Scene",
    "Tolerances",
    "difference_image",
    "gradcheck",
    "random_scene",
    "tangent_image",
]

Renderer = Callable[[Gaussians, Camera, SplatOptions, Tensor], Image]

TIE = 1e-6  # relative difference of two depths that float32 may swap

# The pose moves every Gaussian by hundreds of pixels a unit: so many pixels would leave the band.
SHORTER = {"T_camera_world": 0.03}  # times the step of the differences


@dataclass(frozen=True)
class Tolerances:
    """What counts as right."""

    image32: float = 1e-5  # relative L2 error of colour, alpha and depth
    image64: float = 1e-10
    gradient32: float = 1e-5  # relative L2 error per input
    gradient64: float = 1e-10
    differences: float = 1e-5


def gradcheck(
    fn: Renderer,
    scene: Scene,
    tolerances: Tolerances | None = None,
    entries: int = 6,
    step: float = 1e-6,
    seed: int = 0,
) -> Report:
    """Compare a renderer's image and gradients with the twin's and with all other answers.

    Args:
        fn: ``fn(gaussians, camera, options, background) -> Image``, such as ``torch_op.render``. It
            must take float32 tensors; where it refuses float64 or forward-mode AD, or takes no
            ``T_camera_world`` (4, 4) and ``K`` (3, 3) by name, the report notes it and leaves those
            comparisons out.
        scene: what to render; some hundred Gaussians on some thousand pixels take seconds.
        tolerances: what counts as right.
        entries: how many entries of every input to differentiate one by one.
        step: of the central differences, in the input's units; shorter for the camera's pose.
        seed: of the weights in the loss and of the choice of entries.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # the twin's thousands of small tensors are faster so
    try:
        return _gradcheck(fn, scene, tolerances or Tolerances(), entries, step, seed)
    finally:
        torch.set_num_threads(threads)


def _gradcheck(
    fn: Renderer, scene: Scene, allowed: Tolerances, entries: int, step: float, seed: int
) -> Report:
    generator = Generator().manual_seed(seed)
    twin, notes = scene.rounded(), []
    if {"T_camera_world", "K"} <= inspect.signature(fn).parameters.keys():
        twin = twin.with_camera_inputs().to(torch.float64)
    else:
        notes.append("this renderer takes no T_camera_world and K: their gradients are left out")
    camera, D = twin.camera, len(scene.background)
    band = reference.threshold_band(twin.gaussians, camera, scene.options)
    size = (camera.height, camera.width)
    weights = torch.randn(*size, D + 2, generator=generator, dtype=torch.float64)
    weights = weights * ~band[..., None]

    image, truth = _adjoint(reference.render, twin, weights)
    oracle, rounding = {}, {}
    if len(twin.gaussians):
        oracle = _drjit_gradients(twin, weights)
        moved = _drjit_gradients(_last_bit(twin, generator), weights)
        rounding = {k: _compare("", k, moved[k], g, 0).error for k, g in oracle.items()}
    probes = {name: _choose(g, entries, generator) for name, g in truth.items()}
    rows, errors = [], {}
    for dtype, label, image_allowed, gradient_allowed in (
        (torch.float32, "f32", allowed.image32, allowed.gradient32),
        (torch.float64, "f64", allowed.image64, allowed.gradient64),
    ):
        try:
            found, gradients = _adjoint(fn, twin.to(dtype), weights)
        except (TypeError, ValueError, RuntimeError) as error:
            if dtype == torch.float32:
                raise
            notes.append(f"this renderer has no float64: {error}")
            break
        errors[label] = _errors(found, image) * ~band
        for name in IMAGES:
            a, b = (getattr(of, name).detach().double() for of in (found, image))
            inside = ~band.view(*size, *[1] * (a.ndim - 2))
            row = _compare(f"adjoint {label}", name, a * inside, b * inside, image_allowed)
            rows.append(row)
        for name, g in gradients.items():
            row = _compare(f"adjoint {label}", name, g.double(), truth[name], gradient_allowed)
            rows.append(row)
        try:
            for name, probe in probes.items():
                derivative = partial(tangent_image, fn, twin.to(dtype), name)
                values = _along(derivative, probe, weights)
                method = f"tangent {label}"
                rows.append(_probed(method, name, probe, values, truth[name], gradient_allowed))
        except (NotImplementedError, RuntimeError) as error:
            notes.append(f"this renderer has no tangent in {label}: {str(error).splitlines()[0]}")
        if dtype == torch.float64:
            for name, probe in probes.items():
                length = step * SHORTER.get(name, 1.0)
                derivative = partial(difference_image, fn, twin, name, step=length)
                values = _along(derivative, probe, weights)
                row = _probed("differences", name, probe, values, truth[name], allowed.differences)
                rows.append(row)
    for name, g in oracle.items():
        rows.append(_compare("Dr.Jit AD", name, g, truth[name], allowed.gradient64))
    rows = [
        replace(r, rounding=rounding.get(r.name, 0.0)) if r.method.endswith("f32") else r
        for r in rows
    ]
    maps = Maps(image.color.detach().numpy(), errors["f32"].numpy(), band.numpy())
    ties = _depth_ties(twin)
    n = len(twin.gaussians)
    return Report(tuple(rows), band.numel(), int(band.sum()), n, ties, tuple(notes), maps)


def _draw(fn: Renderer, scene: Scene) -> Image:
    matrices = scene.matrices()
    return fn(scene.gaussians, scene.camera, scene.options, scene.background, **matrices)


def _adjoint(fn: Renderer, scene: Scene, weights: Tensor) -> tuple[Image, dict[str, Tensor]]:
    image = _draw(fn, scene)
    inputs = scene.inputs()
    gradients = torch.autograd.grad(_loss(image, weights), list(inputs.values()), allow_unused=True)
    zero = lambda g, v: torch.zeros_like(v) if g is None else g
    return image, {k: zero(g, v) for (k, v), g in zip(inputs.items(), gradients, strict=True)}


def _loss(image: Image, weights: Tensor) -> Tensor:
    """<w, image>, added up in float64 so that the sum adds no error of its own."""
    color = (image.color.double() * weights[..., :-2]).sum()
    alpha = (image.alpha.double() * weights[..., -2]).sum()
    return color + alpha + (image.depth.double() * weights[..., -1]).sum()


def _errors(found: Image, truth: Image) -> Tensor:
    """The greatest of colour, alpha and depth per pixel, (H, W)."""
    off = [(getattr(found, k).detach().double() - getattr(truth, k).detach()).abs() for k in IMAGES]
    return torch.stack([off[0].amax(dim=-1), off[1], off[2]]).amax(dim=0)


@dataclass(frozen=True)
class _Probe:
    """Along what an input is moved: a direction through all entries, then single entries."""

    everywhere: Tensor  # of the input's shape, of length one
    entries: tuple[tuple[int, ...], ...]

    def directions(self) -> Iterator[Tensor]:
        yield self.everywhere
        for index in self.entries:
            single = torch.zeros_like(self.everywhere)
            single[index] = 1
            yield single

    def of(self, gradient: Tensor) -> Tensor:
        """<gradient, v> for every direction v."""
        return torch.stack([(gradient * v).sum() for v in self.directions()])


def _choose(gradient: Tensor, entries: int, generator: Generator) -> _Probe:
    """The entries with the greatest gradients among a random half."""
    direction = torch.randn(gradient.shape, generator=generator, dtype=torch.float64)
    flat = gradient.reshape(-1).abs() * (torch.rand(gradient.numel(), generator=generator) < 0.5)
    chosen = flat.topk(min(entries, flat.numel())).indices
    at = [tuple(int(i) for i in torch.unravel_index(k, gradient.shape)) for k in chosen]
    return _Probe(direction / max(float(direction.norm()), 1.0), tuple(at))


def tangent_image(fn: Renderer, scene: Scene, name: str, direction: Tensor) -> Image:
    """J v: the image's derivative as one input moves along ``direction``, by forward-mode AD."""
    inputs = {k: v.detach() for k, v in scene.inputs().items()}
    with forward_ad.dual_level():
        moving = forward_ad.make_dual(inputs[name], direction.to(inputs[name].dtype))
        s = scene.with_inputs(inputs | {name: moving})
        image = _draw(fn, s)
        parts = [forward_ad.unpack_dual(getattr(image, k)) for k in IMAGES]
        return Image(*(torch.zeros_like(p[0]) if p[1] is None else p[1] for p in parts))


def difference_image(
    fn: Renderer, scene: Scene, name: str, direction: Tensor, step: float = 1e-6
) -> Image:
    """J v by a central difference of ``step`` times ``direction``."""
    inputs = {k: v.detach() for k, v in scene.inputs().items()}
    ends = []
    for sign in (1, -1):
        s = scene.with_inputs(inputs | {name: inputs[name] + sign * step * direction})
        ends.append(_draw(fn, s))
    slope = lambda k: (getattr(ends[0], k) - getattr(ends[1], k)) / (2 * step)
    return Image(*(slope(k) for k in IMAGES))


def _along(derivative: Callable[[Tensor], Image], probe: _Probe, weights: Tensor) -> list[float]:
    """<w, J v> for every direction v."""
    return [float(_loss(derivative(v), weights)) for v in probe.directions()]


def _drjit_gradients(scene: Scene, weights: Tensor) -> dict[str, Tensor]:
    """By Dr.Jit's autodiff through the loop of autodiff.py."""
    to_drjit = lambda t: TensorXf64(t.detach().contiguous().numpy())
    arrays = {k: to_drjit(v) for k, v in scene.inputs().items()}
    dr.enable_grad(list(arrays.values()))
    others = {k: v for k, v in arrays.items() if k not in scene.gaussians.arrays()}
    gaussians = Gaussians(**{k: v for k, v in arrays.items() if k not in others})
    image = autodiff.render(gaussians, scene.camera, scene.options, **others)
    parts = zip(
        (image.color, image.alpha, image.depth),
        (weights[..., :-2], weights[..., -2], weights[..., -1]),
        strict=True,
    )
    dr.backward(sum(dr.sum(a.array * to_drjit(w).array) for a, w in parts))
    return {k: torch.tensor(dr.grad(v).numpy()) for k, v in arrays.items()}


def _last_bit(scene: Scene, generator: Generator) -> Scene:
    """The scene with every number moved by up to half a unit of its last float32 digit."""
    moved = {}
    for name, v in scene.inputs().items():
        noise = torch.rand(v.shape, generator=generator, dtype=torch.float64)
        moved[name] = v.detach() * (1 + 2**-24 * (2 * noise - 1))
    return scene.with_inputs(moved)


def _compare(method: str, name: str, found: Tensor, truth: Tensor, tolerance: float) -> Row:
    off = found - truth
    norm, norm_found = float(truth.norm()), float(found.norm())
    error = float(off.norm()) / norm if norm else float(off.norm())
    cosine = float((found * truth).sum()) / (norm * norm_found) if norm and norm_found else 1.0
    worst = _index(off.abs())
    value = float(off.abs()[worst]) if off.numel() else 0.0
    return Row(method, name, error, cosine, value, worst, tolerance)


def _probed(
    method: str, name: str, probe: _Probe, values: list[float], truth: Tensor, tolerance: float
) -> Row:
    found = torch.tensor(values, dtype=torch.float64)
    row = _compare(method, name, found, probe.of(truth), tolerance)
    return replace(row, where=((), *probe.entries)[row.where[0]])


def _depth_ties(scene: Scene) -> int:
    T = scene.camera.T_camera_world
    z = np.sort(scene.gaussians.means.detach().numpy() @ T[2, :3] + T[2, 3])
    return int(np.count_nonzero(np.diff(z) < TIE * np.abs(z[1:])))


def _index(values: Tensor) -> tuple[int, ...]:
    if not values.numel():
        return ()
    return tuple(int(i) for i in torch.unravel_index(values.argmax(), values.shape))
