"""Compare a renderer's image and gradients with the reference implementation.

The loss is L = <w, image> with random weights w on colour, alpha and depth. Its gradient by every
input is computed

* by the renderer's adjoint in float32 and in float64,
* by the renderer's tangent (torch's forward-mode AD) in both, along a random direction and along
  single entries: <w, J v> is compared with <J^T w, v>,
* by central differences of the renderer in float64, along the same directions,

and compared with autograd through the reference implementation (splat/reference.py) in float64.

**Fair.** All numbers of the scene, of the camera and of w are rounded to float32 first, and the
reference is evaluated there: only the renderer's own arithmetic is judged.
**Strict.** An error beyond the tolerance fails, whatever the scene. The report also says how far
the *true* gradient moves when the inputs move within their last float32 digit (``rounding``); it
excuses nothing.

The image has steps: where a pixel's alpha or transmittance crosses a cut-off, and where two
Gaussians of one pixel change places in depth. No gradient exists there. The reference finds the
pixels that are that close to a step; they have weight 0 in all comparisons, and are counted.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Generator, Tensor

from gva_mi.core.threads import one_torch_thread
from gva_mi.gradcheck.engine import Comparison, Report
from gva_mi.gradcheck.probes import (
    IMAGES,
    Probe,
    Renderer,
    Tensors,
    difference_image,
    draw,
    gradients,
    images_of,
    loss,
    tangent_image,
)
from gva_mi.splat import reference
from gva_mi.splat.gaussians import Image
from gva_mi.splat.scene import Scene

PRECISIONS = {"f32": torch.float32, "f64": torch.float64}
NO_CAMERA = (
    "this renderer does not differentiate by the camera's T_camera_world and K: their gradients "
    "are missing"
)

ENTRIES = 6  # of every input, differentiated one by one
STEP = 1e-6  # of the central differences, in the input's units
# Inputs in metres move the picture by hundreds of pixels a unit. With a step so much shorter, the
# alpha of a pixel outside the excluded band (1e-4 around its cut-off) does not reach the cut-off.
METRES = {"means": 0.02, "scales": 0.02, "T_camera_world": 0.02}


@dataclass(frozen=True)
class Tolerances:
    """Greatest allowed relative L2 error of an image, or of an input's gradient.

    float32 has 6e-8 per operation, and a pixel is a product of many: 1e-5 leaves two digits for
    that. float64 has nine digits more, of which 1e-10 asks for five.
    """

    image32: float = 1e-5
    image64: float = 1e-10
    adjoint32: float = 1e-5
    adjoint64: float = 1e-10
    tangent32: float = 1e-5
    tangent64: float = 1e-10
    # with a step h = 1e-6, rounding leaves 1e-16 / h, and sums over the picture add many such
    differences: float = 1e-6


@dataclass(frozen=True)
class Maps:
    """Pictures of the check, as numpy arrays."""

    image: np.ndarray  # (H, W, D) by the reference
    error: np.ndarray  # (H, W) greatest error of the float32 image's channels; 0 in the band
    band: np.ndarray  # (H, W) bool, pixels at a step


@dataclass(frozen=True)
class RendererReport(Report):
    """The comparisons of a renderer, and the pixels left out of them."""

    pixels: int = 0
    band: int = 0  # pixels at a step, left out
    band_error: float = 0.0  # greatest error of the float32 image in them
    gaussians: int = 0
    rounding: dict[str, float] = field(default_factory=dict)  # see the module's docstring
    maps: Maps | None = field(default=None, repr=False)

    def finding(self) -> str:
        """The verdict without the scene; a different image first: its gradients differ, too."""
        wrong = [row.name for row in self.rows if not row.passed and not row.coarse]
        images = [name for name in IMAGES if name in wrong]
        found = super().finding()
        if not images:
            return found
        return found.replace("WRONG: ", f"WRONG: your image differs in {', '.join(images)}; ", 1)

    def table(self) -> str:
        """All comparisons as text, and how far the true gradient moves by rounding."""
        found = super().table()
        if not self.rounding:
            return found
        moves = ", ".join(f"{name} {moved:.0e}" for name, moved in self.rounding.items())
        line = f"the inputs' last float32 digit moves the true gradient by: {moves}"
        return found.replace("\n", f"\n{line}\n", 1)

    def to_dict(self) -> dict:
        """The report for JSON, without the pictures."""
        names = ("gaussians", "pixels", "band", "band_error", "rounding")
        return super().to_dict() | {name: getattr(self, name) for name in names}


_DEFAULTS = Tolerances()


def gradcheck(
    fn: Renderer, scene: Scene, tolerances: Tolerances = _DEFAULTS, *, seed: int = 0
) -> RendererReport:
    """Compare a renderer's image and gradients with those of the reference implementation.

    Args:
        fn: ``fn(gaussians, camera, options, background) -> Image``, such as ``splat.render``. It
            must take float32 tensors. Where it refuses float64 or forward-mode AD, or does not
            differentiate by the camera's tensors, the report notes it and omits those comparisons.
        scene: what to render; some hundred Gaussians on some thousand pixels take seconds.
        tolerances: the greatest errors allowed.
        seed: of the weights in the loss and of the choice of entries.
    """
    with one_torch_thread():  # faster for the reference's thousands of small tensors
        generator = Generator().manual_seed(seed)
        by_camera = _differentiates_camera(fn, scene)
        check = _RendererCheck.of(scene, by_camera, generator)
        notes = [] if by_camera else [NO_CAMERA]
        rows, found32 = _answers(fn, check, tolerances, notes)
        moved = _last_digit(check.scene, generator)
        _, other = _by_adjoint(reference.render, moved, check.weights)
    rounding = {k: Comparison.of("", k, other[k], g, 0).error for k, g in check.truth.items()}
    off, band = _errors(found32, check.image), check.band
    band_error = float(off[band].max()) if band.any() else 0.0
    count = len(scene.gaussians)
    subject = f"{count} Gaussians, {band.numel()} pixels"
    if band.any():
        left_out = f"{int(band.sum())} at a step were left out (off by {band_error:.0e})"
        subject = f"{subject} of which {left_out}"
    return RendererReport(
        rows=tuple(rows),
        subject=subject,
        notes=tuple(notes),
        pixels=band.numel(),
        band=int(band.sum()),
        band_error=band_error,
        gaussians=count,
        rounding=rounding if count else {},
        maps=Maps(check.image.color.detach().numpy(), (off * ~band).numpy(), band.numpy()),
    )


@dataclass(frozen=True)
class _RendererCheck:
    """A scene and a loss, and the reference's image and gradients."""

    scene: Scene  # float64, of numbers that float32 holds
    band: Tensor  # (H, W) bool, pixels at a step
    weights: Tensor  # (H, W, D + 2), for colour, alpha and depth; 0 in the band
    image: Image
    truth: Tensors  # gradients
    probes: dict[str, Probe]

    @staticmethod
    def of(scene: Scene, by_camera: bool, generator: Generator) -> _RendererCheck:
        scene = scene.rounded()
        if by_camera:
            scene = scene.with_camera_inputs().to(torch.float64)
        camera, D = scene.camera, len(scene.background)
        band = reference.threshold_band(scene.gaussians, camera, scene.options)
        weights = torch.randn(camera.height, camera.width, D + 2, generator=generator).double()
        weights[band] = 0
        image, truth = _by_adjoint(reference.render, scene, weights)
        probes = {k: Probe.among(g, ENTRIES, generator) for k, g in truth.items()}
        return _RendererCheck(scene, band, weights, image, truth, probes)

    def along(
        self, method: str, name: str, images: Iterator[Image], tolerance: float
    ) -> Comparison:
        """Compare the derivative images along a probe's directions with the true gradient."""
        found = [float(loss(image, self.weights)) for image in images]
        return Comparison.along(method, name, self.probes[name], found, self.truth[name], tolerance)


def _answers(
    fn: Renderer, check: _RendererCheck, tolerances: Tolerances, notes: list[str]
) -> tuple[list[Comparison], Image]:
    """All comparisons of the renderer, and its float32 image."""
    rows, images = [], {}
    for label, dtype in PRECISIONS.items():
        allowed = lambda of, label=label: getattr(tolerances, of + label[1:])
        scene = check.scene.to(dtype)
        try:
            image, found = _by_adjoint(fn, scene, check.weights)
        except (TypeError, ValueError, RuntimeError) as error:
            if label == "f32":
                raise
            notes.append(f"this renderer has no float64: {error}")
            break
        images[label], method = image, f"adjoint {label}"
        for name in images_of(scene):
            a, b = (getattr(of, name).detach().double() for of in (image, check.image))
            inside = ~check.band.view(*check.band.shape, *[1] * (a.ndim - 2))
            rows.append(Comparison.of(method, name, a * inside, b * inside, allowed("image")))
        for name, g in found.items():
            truth = check.truth[name]
            rows.append(Comparison.of(method, name, g.double(), truth, allowed("adjoint")))
        try:
            for name, probe in check.probes.items():
                moves = (tangent_image(fn, scene, name, v) for v in probe.directions())
                rows.append(check.along(f"tangent {label}", name, moves, allowed("tangent")))
        except NotImplementedError as error:
            notes.append(f"this renderer has no tangent in {label}: {str(error).splitlines()[0]}")
        if label == "f64":
            for name, probe in check.probes.items():
                h = STEP * METRES.get(name, 1.0)
                moves = (difference_image(fn, scene, name, v, h) for v in probe.directions())
                rows.append(check.along("differences", name, moves, tolerances.differences))
    return rows, images["f32"]


def _differentiates_camera(fn: Renderer, scene: Scene) -> bool:
    """Whether the picture depends on the camera's tensors."""
    seen = scene.with_camera_inputs().to(torch.float32)
    color = draw(fn, seen).color
    if not color.requires_grad:
        return False
    found = torch.autograd.grad(color.sum(), list(seen.camera.tensors), allow_unused=True)
    return any(gradient is not None for gradient in found)


def _by_adjoint(fn: Renderer, scene: Scene, weights: Tensor) -> tuple[Image, Tensors]:
    """Return the image, and the loss's gradient by every input."""
    image = draw(fn, scene)
    return image, gradients([loss(image, weights)], scene.inputs())


def _last_digit(scene: Scene, generator: Generator) -> Scene:
    """Return the scene with every number moved by up to half a unit of its last float32 digit."""
    moved = {}
    for name, v in scene.inputs().items():
        noise = torch.rand(v.shape, generator=generator, dtype=torch.float64)
        moved[name] = v.detach() * (1 + 2**-24 * (2 * noise - 1))
    return scene.with_inputs(moved).to(torch.float64)


def _errors(found: Image, truth: Image) -> Tensor:
    """Return each pixel's greatest error in colour, alpha and depth, (H, W)."""
    names = [name for name in IMAGES if getattr(truth, name) is not None]
    off = [(getattr(found, k).detach().double() - getattr(truth, k).detach()).abs() for k in names]
    return torch.stack([off[0].amax(dim=-1), *off[1:]]).amax(dim=0)
