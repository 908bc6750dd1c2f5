"""What a gradient check found: rows of figures, a verdict, a table, JSON and a picture."""

from __future__ import annotations

import io
import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from gva_mi.files import replacing

IMAGES = ("color", "alpha", "depth")  # the last one where SplatOptions.depth is on
NAME = 27  # characters of a name in a table
HEAD = (
    f"{'method':12} {'of':{NAME}}"
    + "".join(f" {title:>10}" for title in ("error", "allowed", "1 - cosine", "worst"))
    + "  at"
)
COARSE = 1e-3  # a failing float32 row has lost digits if its error is below this, else it is wrong


@dataclass(frozen=True)
class Comparison:
    """One comparison with the truth."""

    method: str
    name: str  # of the input whose gradient it is, or of the image
    error: float  # relative L2
    cosine: float  # between the two
    worst: float  # greatest absolute error of an entry
    where: tuple[int, ...]  # its index; () for a derivative along a direction of all entries
    tolerance: float

    @staticmethod
    def of(method: str, name: str, found: Tensor, truth: Tensor, tolerance: float) -> Comparison:
        """Compare two tensors of one shape."""
        off = found - truth
        norm, norm_found = float(truth.norm()), float(found.norm())
        error = float(off.norm()) / norm if norm else float(off.norm())
        both = norm * norm_found
        cosine = float((found * truth).sum()) / both if both else 1.0
        if not off.numel():
            return Comparison(method, name, error, cosine, 0.0, (), tolerance)
        where = torch.unravel_index(off.abs().argmax(), off.shape)
        worst = float(off.abs()[where])
        return Comparison(
            method, name, error, cosine, worst, tuple(int(i) for i in where), tolerance
        )

    @property
    def passed(self) -> bool:
        """Whether the error is within the tolerance; a NaN is not."""
        return self.error <= self.tolerance

    @property
    def line(self) -> str:
        """A row of a table under :data:`HEAD`."""
        numbers = (self.error, self.tolerance, 1 - self.cosine, self.worst)
        line = f"{self.method:12} {self.name:{NAME}}" + "".join(f" {x:10.1e}" for x in numbers)
        where = list(self.where) if self.where else "a direction"
        return f"{line}  {where}{'' if self.passed else '  <- FAILS'}"


@dataclass(frozen=True)
class Maps:
    """Pictures of the check; numpy."""

    image: np.ndarray  # (H, W, D) the truth
    error: np.ndarray  # (H, W) greatest error of the float32 image's channels; 0 in the band
    band: np.ndarray  # (H, W) bool, pixels at a step


@dataclass(frozen=True)
class Report:
    """All comparisons of one scene."""

    rows: tuple[Comparison, ...]
    pixels: int
    band: int  # pixels at a step, left out
    band_error: float  # greatest error of the float32 image in them
    gaussians: int
    rounding: dict[str, float]  # relative L2 by which the truth moves with the inputs' last digit
    notes: tuple[str, ...]  # methods that this renderer does not have
    maps: Maps = field(repr=False)

    @property
    def passed(self) -> bool:
        """Whether every row passes."""
        return all(row.passed for row in self.rows)

    @property
    def verdict(self) -> str:
        """What was found, in one sentence."""
        wrong, coarse, images = [], [], []
        for row in self.rows:
            if not row.passed:
                few_digits = row.method.endswith("f32") and row.error < COARSE
                (coarse if few_digits else wrong).append(f"{row.method} of {row.name}")
                if row.name in IMAGES and not few_digits and row.name not in images:
                    images.append(row.name)
        found = f"all {len(self.rows)} comparisons pass"
        if images:  # first: derivatives of another image are others
            found = f"WRONG: your image differs in {', '.join(images)}; {', '.join(wrong)}"
        elif wrong:
            found = f"WRONG: {', '.join(wrong)}"
        elif coarse:
            found = f"less accurate than allowed: {', '.join(coarse)}"
        scene = f"{self.gaussians} Gaussians, {self.pixels} pixels"
        if self.band:
            scene += f" of which {self.band} at a step were left out (off by {self.band_error:.0e})"
        return f"{found} ({scene})"

    def table(self) -> str:
        """All rows and the verdict as text, for a person to read."""
        lines = [HEAD, *(row.line for row in self.rows)]
        if self.rounding:
            moves = ", ".join(f"{name} {moved:.0e}" for name, moved in self.rounding.items())
            lines.append(
                f"the truth itself, with the inputs' last float32 digit, moves by: {moves}"
            )
        return "\n".join([*lines, *self.notes, self.verdict])

    def to_dict(self) -> dict:
        """Everything but the pictures, for JSON."""
        rows = [asdict(row) | {"passed": row.passed} for row in self.rows]
        names = ("passed", "verdict", "gaussians", "pixels", "band", "band_error", "rounding")
        return {k: getattr(self, k) for k in names} | {"notes": list(self.notes), "rows": rows}


def write_json(reports: dict[str, Report], path: Path) -> None:
    """All reports by the name of their scene, and the verdict over all of them."""
    passed = all(report.passed for report in reports.values())
    figures = {"passed": passed, "scenes": {k: r.to_dict() for k, r in reports.items()}}
    with replacing(path) as unfinished:
        unfinished.write_text(json.dumps(figures, indent=1) + "\n")


def write_picture(reports: dict[str, Report], path: Path) -> None:
    """One row per scene: the image, float32's error, every method's error per input."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 3.6 * len(reports)), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(len(reports), 3, squeeze=False, width_ratios=(1, 1.15, 2.6))
    for axes, (name, report) in zip(grid, reports.items(), strict=True):
        draw(report, axes, name)
    whole = io.BytesIO()  # Matplotlib's writers stumble over a disk that fills up
    figure.savefig(whole, dpi=100, format="png")
    with replacing(path) as unfinished:
        unfinished.write_bytes(whole.getbuffer())


def draw(report: Report, axes: Iterable, name: str = "") -> None:
    """The three panels of :func:`write_picture` on matplotlib axes, for notebooks."""
    image, error, bars = axes
    maps = report.maps
    rgb = maps.image[..., :3] if maps.image.shape[2] >= 3 else maps.image[..., 0]
    image.imshow(np.clip(rgb, 0, 1), cmap="gray", vmin=0, vmax=1)
    image.set_title(name or "image")
    shown = error.imshow(np.log10(maps.error + 1e-12), vmin=-8, vmax=-4, cmap="magma")
    error.figure.colorbar(shown, ax=error, shrink=0.8, extend="both")
    y, x = np.nonzero(maps.band)
    error.plot(x, y, "s", ms=4, mfc="none", mec="cyan", mew=1)
    error.set_title(f"log10 |float32 - twin|; {report.band} left out")
    for panel in (image, error):
        panel.set_xticks([])
        panel.set_yticks([])

    methods = list(dict.fromkeys(row.method for row in report.rows))
    names = list(dict.fromkeys(row.name for row in report.rows if row.name not in IMAGES))
    for k, method in enumerate(methods):
        rows = [row for row in report.rows if row.method == method and row.name in names]
        x = np.array([names.index(row.name) for row in rows]) + (k - len(methods) / 2 + 0.5) * 0.12
        line = bars.plot(x, [max(row.error, 1e-17) for row in rows], "o", ms=5, label=method)[0]
        bars.hlines(
            [row.tolerance for row in rows], x - 0.06, x + 0.06, color=line.get_color(), lw=1
        )
    bars.set_yscale("log")
    bars.set_ylim(1e-17, 10)
    bars.set_xticks(range(len(names)), names, fontsize=8, rotation=12)
    bars.set_title("relative L2 error of the gradient; bars: allowed")
    bars.grid(axis="y", alpha=0.3)
    bars.legend(fontsize=8, ncols=3, loc="upper center")
