"""Compare a renderer's image and gradients with the reference implementation.

The loss is L = <w, image> with random weights w on colour, alpha and depth. Its gradient
with respect to every input is computed

* by the renderer's adjoint in float32 and in float64,
* by the renderer's tangent (torch's forward-mode AD) in both, along a random direction and along
  single entries: <w, J v> is compared with <J^T w, v>,
* by central differences of the renderer in float64, along the same directions,

and compared with autograd through the reference implementation (splat/reference.py) in float64.

**Fair.** All numbers of the scene, the camera and w are rounded to float32 first, and the reference
is evaluated at these numbers: only the renderer's own arithmetic is judged.
**Strict.** An error beyond the tolerance fails, whatever the scene. The report also says how far
the *true* gradient moves when the inputs move within their last float32 digit (``rounding``). This
figure changes no verdict.

The image has steps: where a pixel's alpha or transmittance crosses a cut-off, and where two
Gaussians of one pixel exchange their order in depth. No gradient exists at a step. The reference
finds the pixels close to one; they have weight 0 in all comparisons, and are counted.

:func:`write_picture` draws the image, its error in float32, and all errors per input.
"""

from __future__ import annotations

import io
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Generator

from gva_mi.core.atomic import write_bytes
from gva_mi.core.cpu import one_torch_thread
from gva_mi.core.errors import InputError
from gva_mi.gradcheck.causes import causes
from gva_mi.gradcheck.engine import PRECISIONS, Check, Comparison, Report
from gva_mi.gradcheck.probes import (
    IMAGES,
    Probe,
    Renderer,
    Tensors,
    differences,
    drawn,
    gradients,
    images_of,
    leaves,
)
from gva_mi.splat import reference
from gva_mi.splat.camera import CameraTensors
from gva_mi.splat.scene import Scene

NO_DEPTH = "this renderer draws no depth: only colour and alpha are compared"
NO_CAMERA = (
    "this renderer does not differentiate with respect to the camera's T_camera_world and K: their "
    "gradients are missing"
)

# Entries of every input that are differentiated one by one. Chosen: each costs two pictures.
PROBED_ENTRIES = 6
# Step of the central differences, in the input's units. Chosen: rounding leaves 1e-16 / 1e-6, and a
# longer step would reach the cut-offs.
DIFFERENCE_STEP = 1e-6
# Factors of the step. Chosen: inputs in metres move the picture by hundreds of pixels a unit. With
# a step so much shorter, the alpha of a pixel outside the excluded band (1e-4 around its cut-off)
# does not reach the cut-off.
STEP_FACTORS = {"means": 0.02, "scales": 0.02, "T_camera_world": 0.02}

# Greatest relative L2 error allowed of an image, or of an input's gradient. float32 has 6e-8 per
# operation, and a pixel is a product of many: 1e-5 leaves two digits for that. float64 has nine
# digits more, of which 1e-10 asks for five.
TOLERANCES = {"f32": 1e-5, "f64": 1e-10}
# With a step h = 1e-6, rounding leaves 1e-16 / h, and sums over the picture add many such.
DIFFERENCE_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Maps:
    """Pictures of the check, as numpy arrays.

    Example:
        >>> from gva_mi.gradcheck import random_scene
        >>> from gva_mi.splat import render
        >>> scene = random_scene(Generator().manual_seed(0), gaussians=2, width=8, height=8)
        >>> maps = gradcheck(render, scene).maps
        >>> maps.image.shape, bool(maps.error.max() < 1e-5)
        ((8, 8, 3), True)
    """

    image: np.ndarray  # (H, W, D) by the reference
    error: np.ndarray  # (H, W) greatest error of the float32 image's channels; 0 in the band
    band: np.ndarray  # (H, W) bool, pixels at a step


@dataclass(frozen=True)
class RendererReport(Report):
    """The comparisons of a renderer, and the pixels left out of them.

    Example:
        >>> from gva_mi.gradcheck import random_scene
        >>> from gva_mi.splat import render
        >>> scene = random_scene(Generator().manual_seed(0), gaussians=2, width=8, height=8)
        >>> report = gradcheck(render, scene)
        >>> report.passed, report.pixels, report.band
        (True, 64, 0)
    """

    pixels: int = 0
    band: int = 0  # pixels at a step, left out
    gaussians: int = 0
    rounding: dict[str, float] = field(default_factory=dict)  # see the module's docstring
    maps: Maps | None = field(default=None, repr=False)
    causes: tuple[str, ...] = ()  # of a failure, guessed: gva_mi.gradcheck.causes

    def table(self) -> str:
        """Return all comparisons as text, and how far the true gradient moves by rounding."""
        found = "\n".join([super().table(), *self.causes])
        if not self.rounding:
            return found
        moves = ", ".join(f"{name} {moved:.0e}" for name, moved in self.rounding.items())
        line = f"the inputs' last float32 digit moves the true gradient by: {moves}"
        return found.replace("\n", f"\n{line}\n", 1)

    def to_dict(self) -> dict:
        """Return the report for JSON, without the pictures."""
        names = ("gaussians", "pixels", "band", "rounding")
        found = super().to_dict() | {name: getattr(self, name) for name in names}
        return found | {"causes": list(self.causes)}


def gradcheck(fn: Renderer, scene: Scene, *, seed: int = 0) -> RendererReport:
    """Compare a renderer's image and gradients with the reference implementation.

    Args:
        fn: ``fn(gaussians, camera, options, background) -> Image``, such as ``splat.render``. It
            must take float32 tensors. Where it refuses float64 or forward-mode AD, draws no depth,
            or does not differentiate with respect to the camera's tensors, the report notes it and
            omits those comparisons.
        scene: what to render; some hundred Gaussians on some thousand pixels take seconds.
        seed: of the weights in the loss and of the choice of entries.

    Example:
        >>> from gva_mi.gradcheck import random_scene
        >>> from gva_mi.splat import render
        >>> scene = random_scene(Generator().manual_seed(0), gaussians=8, width=16, height=16)
        >>> gradcheck(render, scene).verdict
        'all 46 comparisons pass (8 Gaussians, 256 pixels)'
        >>> def half(*args):  # a wrong gradient of the colours
        ...     image = render(*args)
        ...     color = 0.5 * image.color + 0.5 * image.color.detach()
        ...     return type(image)(color, image.alpha, image.depth)
        >>> report = gradcheck(half, scene)
        >>> report.passed, sorted({row.name for row in report.rows if not row.passed})[:2]
        (False, ['K', 'T_camera_world'])
    """
    with one_torch_thread():  # faster for the reference's thousands of small tensors
        generator = Generator().manual_seed(seed)
        by_camera, by_depth = _capabilities(fn, scene)
        scene = scene.rounded()
        notes = [] if by_camera else [NO_CAMERA]
        if by_camera:
            scene = scene.with_camera_inputs().to(torch.float64)
        if not by_depth:
            notes.append(NO_DEPTH)
            scene = replace(scene, options=replace(scene.options, depth=False))
        check = _check_of(scene, generator)
        rows = _answers(fn, scene, check, notes)
        failed: dict[str, str] = {}
        for row in rows:
            if not row.passed:
                failed[row.name] = ", ".join(filter(None, (failed.get(row.name), row.method)))
        guessed = tuple(causes(fn, scene, check.weights, failed)) if failed else ()
        images = drawn(fn, scene, leaves(scene.inputs(), torch.float32))
        moved = leaves(_last_digit(scene.inputs(), generator))
        other = gradients(drawn(reference.render, scene, moved), moved, check.weights.values())
    rounding = {k: Comparison.of("", k, other[k], g, 0).error for k, g in check.truth.items()}
    pairs = zip(images, check.images.values(), strict=True)
    off = [(image.detach().double() - true).abs() for image, true in pairs]
    off, band = torch.stack([off[0].amax(dim=-1), *off[1:]]).amax(dim=0), check.band
    count = len(scene.gaussians)
    subject = f"{count} Gaussians, {band.numel()} pixels"
    if band.any():
        worst = float(off[band].max())
        subject += f" of which {int(band.sum())} at a step were left out (off by {worst:.0e})"
    return RendererReport(
        rows=tuple(rows),
        subject=subject,
        notes=tuple(notes),
        pixels=band.numel(),
        band=int(band.sum()),
        gaussians=count,
        rounding=rounding if count else {},
        causes=guessed,
        maps=Maps(check.images["color"].numpy(), (off * ~band).numpy(), band.numpy()),
    )


def _check_of(scene: Scene, generator: Generator) -> Check:
    """Draw a loss; return it with the reference's images and gradients."""
    camera, D = scene.camera, len(scene.background)
    band = reference.threshold_band(scene.gaussians, camera, scene.options)
    w = torch.randn(camera.height, camera.width, D + 2, generator=generator).double()
    w[band] = 0
    names, inputs = images_of(scene), leaves(scene.inputs())
    weights = dict(zip(names, (w[..., :D], w[..., D], w[..., D + 1]), strict=False))
    images = drawn(reference.render, scene, inputs)
    probe = lambda gradient: Probe.among(gradient, PROBED_ENTRIES, generator)
    return Check.of(inputs, dict(zip(names, images, strict=True)), weights, band, probe)


def _answers(fn: Renderer, scene: Scene, check: Check, notes: list[str]) -> list[Comparison]:
    """Return all comparisons of the renderer; ``notes`` receives what it lacks."""
    rows, images = [], lambda inputs: drawn(fn, scene, inputs)
    for label in PRECISIONS:
        begun, allowed = len(rows), 3 * [TOLERANCES[label]]
        try:
            for row in check.methods(images, label, *allowed):
                rows.append(row)
        except (TypeError, ValueError, RuntimeError) as error:
            if len(rows) > begun and isinstance(error, NotImplementedError):
                reason = str(error).splitlines()[0]
                notes.append(f"this renderer has no tangent in {label}: {reason}")
            elif label == "f32":
                raise
            else:
                notes.append(f"this renderer has no float64: {error}")
                return rows
    for name in check.truth:
        step = DIFFERENCE_STEP * STEP_FACTORS.get(name, 1.0)
        moves = partial(differences, images, check.values, name, step=step, order=2)
        rows.append(check.along("differences", name, moves, DIFFERENCE_TOLERANCE))
    return rows


def _capabilities(fn: Renderer, scene: Scene) -> tuple[bool, bool]:
    """Whether the picture depends on the camera's tensors, and whether there is a depth image.

    Raises:
        InputError: the renderer returns no colour or alpha, or images of other shapes.
    """
    seen = scene.with_camera_inputs()
    inputs = leaves(seen.inputs(), torch.float32)
    moved = seen.with_inputs(inputs)
    image = fn(moved.gaussians, moved.camera, moved.options, moved.background)
    size = (scene.camera.height, scene.camera.width)
    for name in images_of(scene):
        shape = (*size, len(scene.background)) if name == "color" else size
        found = getattr(image, name, None)
        if (found is not None or name != "depth") and tuple(getattr(found, "shape", ())) != shape:
            what = "None" if found is None else f"{tuple(getattr(found, 'shape', ()))}"
            raise InputError(f"gradcheck(): the renderer's {name} must be {shape}, got {what}")
    by_depth, color = image.depth is not None or not scene.options.depth, image.color
    if not color.requires_grad:
        return False, by_depth
    matrices = [inputs[name] for name in CameraTensors._fields]
    found = torch.autograd.grad(color.sum(), matrices, allow_unused=True)
    return any(gradient is not None for gradient in found), by_depth


def _last_digit(inputs: Tensors, generator: Generator) -> Tensors:
    """Return the inputs with every number moved by up to half a unit of its last float32 digit."""
    noise = lambda v: torch.rand(v.shape, generator=generator, dtype=torch.float64)
    return {k: v.detach() * (1 + 2**-24 * (2 * noise(v) - 1)) for k, v in inputs.items()}


def write_picture(reports: dict[str, RendererReport], path: Path) -> None:
    """Draw the reports of several scenes, one row of three panels each; write the .png file.

    Example:
        >>> import tempfile
        >>> maps = Maps(np.zeros((8, 8, 3)), np.zeros((8, 8)), np.zeros((8, 8), bool))
        >>> row = Comparison("adjoint f32", "means", 1e-6, 1e-5, (0, 0), tolerance=1e-5)
        >>> path = Path(tempfile.mkdtemp()) / "gradcheck.png"
        >>> write_picture({"black": RendererReport((row,), "8 Gaussians", maps=maps)}, path)
        >>> path.read_bytes()[1:4]
        b'PNG'
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 3.6 * len(reports)), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(reports), 3, squeeze=False, width_ratios=(1, 1.15, 2.6))
    for axes, (name, report) in zip(grid, reports.items(), strict=True):
        draw_report(report, axes, name)
    whole = io.BytesIO()  # written in one piece: Matplotlib's writers fail badly on a full disk
    figure.savefig(whole, dpi=100, format="png")
    write_bytes(path, whole.getbuffer())


def draw_report(report: RendererReport, axes: Iterable, name: str = "") -> None:
    """Draw the three panels of a report on matplotlib axes.

    Example:
        >>> from matplotlib.figure import Figure
        >>> maps = Maps(np.zeros((8, 8, 3)), np.zeros((8, 8)), np.zeros((8, 8), bool))
        >>> row = Comparison("adjoint f32", "means", 1e-6, 1e-5, (0, 0), tolerance=1e-5)
        >>> panels = Figure().subplots(1, 3)
        >>> draw_report(RendererReport((row,), "8 Gaussians", maps=maps), panels, "black")
        >>> [panel.get_title() for panel in panels][:2]
        ['black', 'log10 |float32 - reference|; 0 left out']
    """
    image, error, bars = axes
    maps = report.maps
    rgb = maps.image[..., :3] if maps.image.shape[2] >= 3 else maps.image[..., 0]
    image.imshow(np.clip(rgb, 0, 1), cmap="gray", vmin=0, vmax=1)
    image.set_title(name or "image")
    shown = error.imshow(np.log10(maps.error + 1e-12), vmin=-8, vmax=-4, cmap="magma")
    error.figure.colorbar(shown, ax=error, shrink=0.8, extend="both")
    y, x = np.nonzero(maps.band)
    error.plot(x, y, "s", ms=4, mfc="none", mec="cyan", mew=1)
    error.set_title(f"log10 |float32 - reference|; {report.band} left out")
    for panel in (image, error):
        panel.set(xticks=[], yticks=[])

    methods = list(dict.fromkeys(row.method for row in report.rows))
    names = list(dict.fromkeys(row.name for row in report.rows if row.name not in IMAGES))
    for k, method in enumerate(methods):
        rows = [row for row in report.rows if row.method == method and row.name in names]
        x = np.array([names.index(row.name) for row in rows]) + (k - len(methods) / 2 + 0.5) * 0.12
        line = bars.plot(x, [max(row.error, 1e-17) for row in rows], "o", ms=5, label=method)[0]
        allowed = [row.tolerance for row in rows]
        bars.hlines(allowed, x - 0.06, x + 0.06, color=line.get_color(), lw=1)
    bars.set(yscale="log", ylim=(1e-17, 10))
    bars.set_xticks(range(len(names)), names, fontsize=8, rotation=12)
    bars.set_title("relative L2 error of the gradient; bars: allowed")
    bars.grid(axis="y", alpha=0.3)
    bars.legend(fontsize=8, ncols=3, loc="upper center")
