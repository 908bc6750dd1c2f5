"""The comparison: every method's gradient of one scalar loss, beside the slow twin's.

The loss is L = <w, image> with random weights w on colour, alpha and depth. Its gradient by every
input is taken

* by the renderer's adjoint in float32 and in float64,
* by the renderer's tangent (torch's forward-mode AD) in both, along a random direction and along
  single entries: <w, J v> is compared with <J^T w, v>,
* by central differences of the renderer in float64, along the same,
* by Dr.Jit's own autodiff through a plain loop (autodiff.py), in float64,
* by autograd through the twin (reference.py), in float64: what the others are compared with.

What float32 is compared with is fair and strict. Fair: every number of the scene, of the camera
and of w is rounded to float32 first, and the float64 twin is evaluated there, so that both see the
same question and only the renderer's own arithmetic is judged. Strict: an error beyond the
tolerance fails, whatever the scene. The report also says how far the *true* gradient moves when
the inputs move within their last float32 digit (``Report.rounding``); it excuses nothing.

The image has steps: where a pixel's alpha or transmittance crosses a cut-off, and where two
Gaussians of one pixel change places in depth. There the last digit decides, and no gradient exists.
The twin finds the pixels that are that close, once; they have weight 0 in the one w that all
methods and both precisions share, so that the same pixels are left out of every comparison, and
they are counted.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import drjit as dr
import torch
from drjit.llvm.ad import TensorXf64
from torch import Generator, Tensor

from gva_mi.splat import reference
from gva_mi.splat.camera import CameraTensors
from gva_mi.splat.gaussians import Gaussians, Image
from gva_mi.splat.gradcheck import autodiff
from gva_mi.splat.gradcheck.directions import (
    Probe,
    Renderer,
    difference_image,
    draw,
    images_of,
    loss,
    tangent_image,
)
from gva_mi.splat.gradcheck.verdict import IMAGES, Comparison, Maps, Report
from gva_mi.splat.scene import Scene
from gva_mi.threads import one_torch_thread

PRECISIONS = {"f32": torch.float32, "f64": torch.float64}

# Inputs in metres move the picture by hundreds of pixels a unit. With a step so much shorter, the
# alpha of a pixel off the band (1e-4 from its cut-off) does not reach it.
METRES = {"means": 0.02, "scales": 0.02, "T_camera_world": 0.02}


@dataclass(frozen=True)
class Tolerances:
    """What counts as right: the greatest relative L2 error of an image, or of an input's gradient.

    float32 has 6e-8 per operation, and a pixel is a product of many: 1e-5 leaves two digits for
    that. float64 has nine digits more, of which 1e-10 asks for five. A tangent is the same
    derivative as the adjoint, and is asked for the same; Dr.Jit's autodiff is float64 throughout.
    """

    image32: float = 1e-5
    image64: float = 1e-10
    adjoint32: float = 1e-5
    adjoint64: float = 1e-10
    tangent32: float = 1e-5
    tangent64: float = 1e-10
    autodiff: float = 1e-10
    # with a step h = 1e-6, rounding leaves 1e-16 / h, and sums over the picture add many such
    differences: float = 1e-6


_DEFAULTS = Tolerances()


def gradcheck(
    fn: Renderer,
    scene: Scene,
    tolerances: Tolerances = _DEFAULTS,
    *,
    images: tuple[str, ...] = IMAGES,
    entries: int = 6,
    step: float = 1e-6,
    seed: int = 0,
) -> Report:
    """Compare a renderer's image and gradients with the twin's and with all other answers.

    Args:
        fn: ``fn(gaussians, camera, options, background) -> Image``, such as ``torch_op.render``. It
            must take float32 tensors; where it refuses float64 or forward-mode AD, or does not
            differentiate by the camera's tensors, the report notes it and leaves those comparisons
            out.
        scene: what to render; some hundred Gaussians on some thousand pixels take seconds.
        tolerances: what counts as right.
        images: which of "color", "alpha" and "depth" are in the loss.
        entries: how many entries of every input to differentiate one by one.
        step: of the central differences, in the input's units; 0.02 of it for those in metres.
        seed: of the weights in the loss and of the choice of entries.
    """
    unknown = set(images) - set(IMAGES)
    if unknown or not images:
        raise ValueError(f"gradcheck(): images must be some of {', '.join(IMAGES)}, got {images}")
    with one_torch_thread():  # the twin's thousands of small tensors are faster so
        generator = Generator().manual_seed(seed)
        by_camera = _differentiates_camera(fn, scene)
        asked = _Asked.of(scene, by_camera, images, entries, generator)
        notes = []
        if not by_camera:
            notes.append(
                "this renderer does not differentiate by the camera's T_camera_world and K: their "
                "gradients are missing"
            )
        rows, found32 = _answers(fn, asked, tolerances, step, notes)
        truth, rounding = asked.gradients, {}
        if len(scene.gaussians):
            by_loop = _by_autodiff(asked.scene, asked.weights)
            rows += [
                Comparison.of("Dr.Jit AD", name, g, truth[name], tolerances.autodiff)
                for name, g in by_loop.items()
            ]
            moved = _by_autodiff(_last_digit(asked.scene, generator), asked.weights)
            rounding = {k: Comparison.of("", k, moved[k], g, 0.0).error for k, g in by_loop.items()}
    off = _errors(found32, asked.image)
    picture = asked.image.color.detach().numpy()
    return Report(
        rows=tuple(rows),
        pixels=asked.band.numel(),
        band=int(asked.band.sum()),
        band_error=float(off[asked.band].max()) if asked.band.any() else 0.0,
        gaussians=len(scene.gaussians),
        rounding=rounding,
        notes=tuple(notes),
        maps=Maps(picture, (off * ~asked.band).numpy(), asked.band.numpy()),
    )


@dataclass(frozen=True)
class _Asked:
    """The question that every method answers, and the twin's answer."""

    scene: Scene  # float64, of numbers that float32 holds
    band: Tensor  # (H, W) bool, pixels at a step
    weights: Tensor  # (H, W, D + 2), for colour, alpha and depth; 0 in the band
    image: Image
    gradients: dict[str, Tensor]
    probes: dict[str, Probe]

    @staticmethod
    def of(
        scene: Scene, by_camera: bool, images: tuple[str, ...], entries: int, generator: Generator
    ) -> _Asked:
        scene = scene.rounded()
        if by_camera:
            scene = scene.with_camera_inputs().to(torch.float64)
        camera, D = scene.camera, len(scene.background)
        band = reference.threshold_band(scene.gaussians, camera, scene.options)
        weights = torch.randn(camera.height, camera.width, D + 2, generator=generator).double()
        weights[band] = 0
        for columns, name in ((slice(D), "color"), (D, "alpha"), (D + 1, "depth")):
            if name not in images:
                weights[..., columns] = 0
        image, gradients = _by_adjoint(reference.render, scene, weights)
        probes = {k: Probe.among(g, entries, generator) for k, g in gradients.items()}
        return _Asked(scene, band, weights, image, gradients, probes)


def _answers(
    fn: Renderer, asked: _Asked, tolerances: Tolerances, step: float, notes: list[str]
) -> tuple[list[Comparison], Image]:
    """The rows of all methods of the renderer itself, and its float32 image."""
    rows, images = [], {}
    for label, dtype in PRECISIONS.items():
        allowed = lambda of, label=label: getattr(tolerances, of + label[1:])
        try:
            image, gradients = _by_adjoint(fn, asked.scene.to(dtype), asked.weights)
        except (TypeError, ValueError, RuntimeError) as error:
            if label == "f32":
                raise
            notes.append(f"this renderer has no float64: {error}")
            break
        images[label], method = image, f"adjoint {label}"
        for name in images_of(asked.scene):
            a, b = (getattr(of, name).detach().double() for of in (image, asked.image))
            inside = ~asked.band.view(*asked.band.shape, *[1] * (a.ndim - 2))
            rows.append(Comparison.of(method, name, a * inside, b * inside, allowed("image")))
        for name, g in gradients.items():
            row = Comparison.of(method, name, g.double(), asked.gradients[name], allowed("adjoint"))
            rows.append(row)
        try:
            rows += list(_by_tangent(fn, asked, label, allowed("tangent")))
        except NotImplementedError as error:
            notes.append(f"this renderer has no tangent in {label}: {str(error).splitlines()[0]}")
        if label == "f64":
            rows += list(_by_differences(fn, asked, step, tolerances.differences))
    return rows, images["f32"]


def _differentiates_camera(fn: Renderer, scene: Scene) -> bool:
    """Whether the picture depends on the camera's tensors."""
    seen = scene.with_camera_inputs().to(torch.float32)
    color = draw(fn, seen).color
    if not color.requires_grad:
        return False
    found = torch.autograd.grad(color.sum(), list(seen.camera.tensors), allow_unused=True)
    return any(gradient is not None for gradient in found)


def _by_adjoint(fn: Renderer, scene: Scene, weights: Tensor) -> tuple[Image, dict[str, Tensor]]:
    image = draw(fn, scene)
    inputs = scene.inputs()
    wanted = list(inputs.values())
    gradients = torch.autograd.grad(loss(image, weights), wanted, allow_unused=True)
    zero = lambda g, v: torch.zeros_like(v) if g is None else g
    return image, {k: zero(g, v) for (k, v), g in zip(inputs.items(), gradients, strict=True)}


def _by_tangent(fn: Renderer, asked: _Asked, label: str, tolerance: float) -> Iterator[Comparison]:
    scene = asked.scene.to(PRECISIONS[label])
    for name, probe in asked.probes.items():
        images = (tangent_image(fn, scene, name, v) for v in probe.directions())
        yield _probed(f"tangent {label}", name, images, asked, tolerance)


def _by_differences(
    fn: Renderer, asked: _Asked, step: float, tolerance: float
) -> Iterator[Comparison]:
    for name, probe in asked.probes.items():
        h = step * METRES.get(name, 1.0)
        images = (difference_image(fn, asked.scene, name, v, h) for v in probe.directions())
        yield _probed("differences", name, images, asked, tolerance)


def _by_autodiff(scene: Scene, weights: Tensor) -> dict[str, Tensor]:
    """The gradients by Dr.Jit's own autodiff, through the loop of autodiff.py."""
    to_drjit = lambda t: TensorXf64(t.detach().contiguous().numpy())
    arrays = {k: to_drjit(v) for k, v in scene.inputs().items()}
    dr.enable_grad(list(arrays.values()))
    gaussians = Gaussians(**{k: arrays[k] for k in scene.gaussians.arrays()})
    matrices = {k: arrays[k] for k in CameraTensors._fields if k in arrays}
    camera = scene.camera.with_matrices(**matrices) if matrices else scene.camera
    image = autodiff.render(gaussians, camera, scene.options, arrays["background"])
    parts = zip(
        (getattr(image, name) for name in images_of(scene)),
        (weights[..., :-2], weights[..., -2], weights[..., -1]),
        strict=False,
    )
    dr.backward(sum(dr.sum(a.array * to_drjit(w).array) for a, w in parts))
    return {k: torch.tensor(dr.grad(v).numpy()) for k, v in arrays.items()}


def _last_digit(scene: Scene, generator: Generator) -> Scene:
    """The scene with every number moved by up to half a unit of its last float32 digit."""
    moved = {}
    for name, v in scene.inputs().items():
        noise = torch.rand(v.shape, generator=generator, dtype=torch.float64)
        moved[name] = v.detach() * (1 + 2**-24 * (2 * noise - 1))
    return scene.with_inputs(moved)


def _probed(
    method: str, name: str, images: Iterator[Image], asked: _Asked, tolerance: float
) -> Comparison:
    """<w, J v> against <J^T w, v> for every direction v of a probe."""
    probe = asked.probes[name]
    values = [float(loss(image, asked.weights)) for image in images]
    found = torch.tensor(values, dtype=torch.float64)
    row = Comparison.of(method, name, found, probe.along(asked.gradients[name]), tolerance)
    return replace(row, where=((), *probe.entries)[row.where[0]])


def _errors(found: Image, truth: Image) -> Tensor:
    """Each pixel's greatest error in colour, alpha and depth, (H, W)."""
    names = [name for name in IMAGES if getattr(truth, name) is not None]
    off = [(getattr(found, k).detach().double() - getattr(truth, k).detach()).abs() for k in names]
    return torch.stack([off[0].amax(dim=-1), *off[1:]]).amax(dim=0)
