"""A report's page: one HTML file that holds its pictures and opens from disk.

A page is a heading, some large figures, and sections of text, pictures and tables.
"""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gva_mi.files import replacing

if TYPE_CHECKING:
    from jinja2 import Template
    from matplotlib.figure import Figure as Plot

COLUMNS = 5  # pictures beside each other


@dataclass(frozen=True)
class Picture:
    """An image in the page."""

    caption: str
    data: str  # a data: address


@dataclass(frozen=True)
class Table:
    """Rows of text under a head."""

    head: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True)
class Section:
    """A part of the page: what is to be seen, and the pictures of it."""

    title: str
    text: str
    pictures: Sequence[Picture] = ()
    columns: int = COLUMNS
    tables: Sequence[Table] = field(default=())


@dataclass(frozen=True)
class Figure:
    """One of the large figures at the top."""

    value: str
    label: str


def write_page(
    path: Path,
    *,
    title: str,
    subtitle: str,
    figures: Sequence[Figure],
    sections: Sequence[Section],
    settings: dict,
) -> None:
    """Write the page.

    Args:
        path: the ``.html`` file.
        title: its heading.
        subtitle: a sentence below.
        figures: the large ones.
        sections: in their order.
        settings: options, versions, seed; shown as JSON at the end.
    """
    text = _template().render(
        title=title,
        subtitle=subtitle,
        figures=figures,
        sections=sections,
        settings=json.dumps(settings, indent=2),
    )
    with replacing(path) as unfinished:
        unfinished.write_text(text)


def picture(caption: str, image: np.ndarray) -> Picture:
    """A picture (H, W, 3), 8-bit or in [0, 1]."""
    from PIL import Image

    if image.dtype != np.uint8:
        image = np.round(np.clip(image, 0, 1) * 255).astype(np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, "WEBP", quality=92)
    return Picture(caption, _address(buffer.getvalue(), "webp"))


def animation(caption: str, images: Sequence[np.ndarray]) -> Picture:
    """8-bit pictures (H, W, 3) one after the other, again and again."""
    from PIL import Image

    first, *rest = (Image.fromarray(image) for image in images)
    buffer = io.BytesIO()
    first.save(buffer, "WEBP", save_all=True, append_images=rest, duration=100, loop=0, quality=88)
    return Picture(caption, _address(buffer.getvalue(), "webp"))


def plot(caption: str, drawn: Plot) -> Picture:
    """What Matplotlib drew; the figure is closed."""
    import matplotlib.pyplot as plt

    buffer = io.BytesIO()
    drawn.savefig(buffer, format="svg")
    plt.close(drawn)
    return Picture(caption, _address(buffer.getvalue(), "svg+xml"))


def number(value: float | None, digits: int) -> str:
    """A figure in a table; a dash where there is none."""
    return "–" if value is None else f"{value:.{digits}f}"


def around(inside: np.ndarray, margin: int) -> tuple[slice, slice]:
    """Rows and columns that hold all that is inside, and a margin."""
    if not inside.any():
        return slice(None), slice(None)
    found = []
    for axis in (1, 0):
        where = np.flatnonzero(inside.any(axis))
        low, high = where[0] - margin, where[-1] + 1 + margin
        found.append(slice(max(0, low), min(inside.shape[1 - axis], high)))
    return found[0], found[1]


def _address(data: bytes, kind: str) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"


def _template() -> Template:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    loader = PackageLoader("gva_mi", ".")
    environment = Environment(loader=loader, autoescape=True, undefined=StrictUndefined)
    return environment.get_template("page.html")
