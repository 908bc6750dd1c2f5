"""Draw a renderer's gradient check: the image, float32's error, all errors per input."""

from __future__ import annotations

import io
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from gva_mi.core.atomic import write_bytes
from gva_mi.gradcheck.probes import IMAGES
from gva_mi.gradcheck.splat import RendererReport


def write_picture(reports: dict[str, RendererReport], path: Path) -> None:
    """Write one row of three panels per scene."""
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
    """Draw the three panels of a report on matplotlib axes."""
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
