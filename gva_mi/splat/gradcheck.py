"""Whether a renderer's gradients are right: four independent answers side by side.

For a scalar loss L = <w, image>, with random weights w on colour, alpha and depth, the gradient by
every input is taken

* by the renderer's adjoint in float32 and in float64,
* by autograd through the slow twin (reference.py), in float64: what the others are compared with,
* by central differences of the renderer in float64, at a handful of entries.

The image has steps where a pixel's alpha or transmittance crosses a cut-off. Pixels in a narrow
band around them have no weight in the loss, and are counted: there the last digit decides, and no
gradient exists.

    report = gradcheck(render, random_scene(torch.Generator().manual_seed(0)))
    assert report.passed, report.table()
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Generator, Tensor

from gva_mi.splat import reference
from gva_mi.splat.camera import Camera, look_at
from gva_mi.splat.gaussians import Gaussians, Image
from gva_mi.splat.options import SplatOptions

Renderer = Callable[[Gaussians, Camera, SplatOptions, Tensor], Image]


@dataclass(frozen=True)
class Scene:
    """Everything a picture is made of."""

    gaussians: Gaussians  # float64 torch tensors
    camera: Camera
    background: Tensor  # (D,) float64
    options: SplatOptions = SplatOptions()

    def inputs(self) -> dict[str, Tensor]:
        """What is differentiated, by name."""
        g = self.gaussians
        named = {"means": g.means, "quats": g.quats, "scales": g.scales, "opacities": g.opacities}
        named |= {"colors": g.colors} if g.sh is None else {"sh": g.sh}
        return named | {"background": self.background}

    def with_inputs(self, inputs: dict[str, Tensor]) -> Scene:
        """The same scene with other tensors."""
        inputs = dict(inputs)
        background = inputs.pop("background")
        return replace(self, gaussians=Gaussians(**inputs), background=background)

    def to(self, dtype: torch.dtype) -> Scene:
        """The same scene in another precision, detached and ready for gradients."""
        inputs = self.inputs().items()
        return self.with_inputs({k: v.detach().to(dtype).requires_grad_() for k, v in inputs})


@dataclass(frozen=True)
class Tolerances:
    """What counts as right."""

    image32: float = 1e-5  # greatest error of the float32 image, colours of about 1
    image64: float = 1e-10
    gradient32: float = 1e-5  # relative L2 error per input
    gradient64: float = 1e-10
    differences: float = 1e-5


@dataclass(frozen=True)
class Row:
    """One comparison with the twin."""

    method: str
    name: str  # of the input, or of the image
    error: float  # relative L2 for gradients, greatest absolute for images
    cosine: float  # between the two; 1 for images
    worst: float  # greatest absolute error of an entry
    where: tuple[int, ...]  # its index
    tolerance: float

    @property
    def passed(self) -> bool:
        """A NaN does not pass."""
        return self.error <= self.tolerance


@dataclass(frozen=True)
class Report:
    """All comparisons of one scene."""

    rows: tuple[Row, ...]
    pixels: int
    band: int  # pixels at a cut-off, left out

    @property
    def passed(self) -> bool:
        """Whether every row is within its tolerance."""
        return all(row.passed for row in self.rows)

    def table(self) -> str:
        """For a person to read."""
        titles = ("error", "allowed", "1 - cosine", "worst")
        lines = [f"{'method':12} {'of':11}" + "".join(f" {title:>10}" for title in titles) + "  at"]
        for r in self.rows:
            numbers = (r.error, r.tolerance, 1 - r.cosine, r.worst)
            line = f"{r.method:12} {r.name:11}" + "".join(f" {number:10.1e}" for number in numbers)
            lines.append(f"{line}  {list(r.where)}{'' if r.passed else '  <- fails'}")
        verdict = "all pass" if self.passed else "FAILS"
        lines.append(
            f"{self.band} of {self.pixels} pixels lie at a cut-off and were left out; {verdict}"
        )
        return "\n".join(lines)


def gradcheck(
    fn: Renderer,
    scene: Scene,
    tolerances: Tolerances | None = None,
    entries: int = 6,
    step: float = 1e-6,
    seed: int = 0,
) -> Report:
    """Compare a renderer's image and gradients with the twin's and with differences.

    Args:
        fn: ``fn(gaussians, camera, options, background) -> Image``, such as ``torch_op.render``.
        scene: what to render; some hundred Gaussians on some thousand pixels take seconds.
        tolerances: what counts as right.
        entries: how many entries of every input to differentiate by central differences.
        step: their step, in the input's units.
        seed: of the weights in the loss and of the choice of entries.
    """
    allowed = tolerances or Tolerances()
    generator = Generator().manual_seed(seed)
    camera, D = scene.camera, len(scene.background)
    twin = scene.to(torch.float64)
    band = reference.threshold_band(twin.gaussians, camera, scene.options)
    size = (camera.height, camera.width)
    weights = torch.randn(*size, D + 2, generator=generator, dtype=torch.float64)
    weights = weights * ~band[..., None]

    image, gradient = _run(reference.render, twin, weights)
    rows = []
    for dtype, label, image_error, gradient_error in (
        (torch.float32, "adjoint f32", allowed.image32, allowed.gradient32),
        (torch.float64, "adjoint f64", allowed.image64, allowed.gradient64),
    ):
        found, gradients = _run(fn, scene.to(dtype), weights)
        for name in ("color", "alpha", "depth"):
            a, b = getattr(found, name).detach(), getattr(image, name).detach()
            off = (a.double() - b).abs() * ~band.view(*size, *[1] * (a.ndim - 2))
            worst = _index(off)
            error = float(off[worst])
            rows.append(Row(label, name, error, 1.0, error, worst, image_error))
        for name, g in gradients.items():
            rows.append(_compare(label, name, g.double(), gradient[name], gradient_error))
    for name in scene.inputs():
        rows.append(
            _differences(
                fn, scene, weights, name, gradient[name], entries, step, generator, allowed
            )
        )
    return Report(tuple(rows), band.numel(), int(band.sum()))


def _run(fn: Renderer, scene: Scene, weights: Tensor) -> tuple[Image, dict[str, Tensor]]:
    image = fn(scene.gaussians, scene.camera, scene.options, scene.background)
    inputs = scene.inputs()
    gradients = torch.autograd.grad(_loss(image, weights), list(inputs.values()), allow_unused=True)
    zero = lambda g, v: torch.zeros_like(v) if g is None else g
    return image, {k: zero(g, v) for (k, v), g in zip(inputs.items(), gradients, strict=True)}


def _loss(image: Image, weights: Tensor) -> Tensor:
    """<w, image>, added up in float64 so that the sum adds no error of its own."""
    color = (image.color.double() * weights[..., :-2]).sum()
    alpha = (image.alpha.double() * weights[..., -2]).sum()
    return color + alpha + (image.depth.double() * weights[..., -1]).sum()


def _compare(method: str, name: str, found: Tensor, truth: Tensor, tolerance: float) -> Row:
    off = found - truth
    norm, norm_found = float(truth.norm()), float(found.norm())
    error = float(off.norm()) / norm if norm else float(off.norm())
    cosine = float((found * truth).sum()) / (norm * norm_found) if norm and norm_found else 1.0
    worst = _index(off.abs())
    return Row(method, name, error, cosine, float(off.abs()[worst]), worst, tolerance)


def _differences(
    fn: Renderer,
    scene: Scene,
    weights: Tensor,
    name: str,
    truth: Tensor,
    entries: int,
    step: float,
    generator: Generator,
    allowed: Tolerances,
) -> Row:
    """Central differences at the entries with the greatest gradients among a random half."""
    flat = truth.reshape(-1).abs() * (torch.rand(truth.numel(), generator=generator) < 0.5)
    chosen = flat.topk(min(entries, flat.numel())).indices.tolist()
    inputs = {k: v.detach().double() for k, v in scene.inputs().items()}
    found = []
    for k in chosen:
        losses = []
        for sign in (1, -1):
            moved = inputs[name].clone()
            moved.view(-1)[k] += sign * step
            s = scene.with_inputs(inputs | {name: moved})
            losses.append(float(_loss(fn(s.gaussians, s.camera, s.options, s.background), weights)))
        found.append((losses[0] - losses[1]) / (2 * step))
    found = torch.tensor(found, dtype=torch.float64)
    row = _compare("differences", name, found, truth.reshape(-1)[chosen], allowed.differences)
    where = torch.unravel_index(torch.tensor(chosen[row.where[0]]), truth.shape)
    return replace(row, where=tuple(int(i) for i in where))


def _index(values: Tensor) -> tuple[int, ...]:
    if not values.numel():
        return ()
    return tuple(int(i) for i in torch.unravel_index(values.argmax(), values.shape))


def random_scene(
    generator: Generator,
    gaussians: int = 40,
    width: int = 32,
    height: int = 32,
    degree: int | None = None,
    channels: int = 3,
) -> Scene:
    """Gaussians strewn about the origin, some beyond the picture's border, seen from 3 m.

    Args:
        generator: of all random numbers.
        gaussians: how many.
        width, height: of the picture.
        degree: of the spherical harmonics; None gives plain colours.
        channels: of the plain colours.
    """
    n = gaussians
    uniform = lambda low, high, *shape: (
        low + (high - low) * torch.rand(*shape, generator=generator, dtype=torch.float64)
    )
    normal = lambda *shape: torch.randn(*shape, generator=generator, dtype=torch.float64)
    kwargs = {"colors": uniform(0, 1, n, channels)}
    if degree is not None:
        kwargs, channels = {"sh": 0.4 * normal(n, (degree + 1) ** 2, 3)}, 3
    values = Gaussians(
        means=uniform(-1, 1, n, 3) * torch.tensor([1.0, 1.0, 0.6], dtype=torch.float64),
        quats=normal(n, 4),
        scales=torch.exp(uniform(math.log(0.03), math.log(0.3), n, 3)),
        opacities=uniform(0.05, 1.0, n),
        **kwargs,
    )
    T_camera_world = look_at((0.6, 0.4, 2.9), (0.0, 0.0, 0.0))
    focal = 1.7 * max(width, height)
    camera = Camera(
        focal, 1.05 * focal, width / 2 + 0.7, height / 2 - 0.4, T_camera_world, width, height
    )
    return Scene(values, camera, uniform(0, 1, channels))
