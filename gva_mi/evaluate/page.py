"""Reports: one HTML file with its pictures inside that opens from disk.

A page is a heading, perhaps a verdict, and sections of text, large numbers, pictures and tables.
"""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.core.atomic import atomic_write
from gva_mi.evaluate.figures import Table


@dataclass(frozen=True)
class Picture:
    """An image in the page."""

    caption: str
    data: str  # a data: address


@dataclass(frozen=True)
class Headline:
    """A large number, or a few large words."""

    value: str
    label: str


@dataclass(frozen=True)
class Section:
    """A part of the page; ``page.html`` holds what it says, by its title."""

    title: str
    pictures: Sequence[Picture] = ()
    columns: int = 5  # pictures side by side
    close_ups: Sequence[Picture] = ()  # below the pictures, in rows of their own
    tables: Sequence[Table] = ()
    text: str = ""  # what it says besides
    headlines: Sequence[Headline] = ()
    scale: Sequence[tuple[tuple[int, int, int], str]] = ()  # 8-bit colours and their meaning
    link: tuple[str, str] = ("", "")  # a file beside the page, and what it shows


def write_page(
    path: Path,
    *,
    title: str,
    subtitle: str,
    sections: Sequence[Section],
    settings: dict[str, Any],
    verdict: Headline | None = None,
) -> None:
    """Write the page; ``settings`` (options, versions, seed) are shown as JSON at its end."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    loader = PackageLoader("gva_mi.evaluate", ".")
    environment = Environment(loader=loader, autoescape=True, undefined=StrictUndefined)
    text = environment.get_template("page.html").render(
        title=title,
        subtitle=subtitle,
        verdict=verdict,
        sections=sections,
        settings=json.dumps(settings, indent=2, default=str),
    )
    with atomic_write(path) as unfinished:
        unfinished.write_text(text, "utf-8", "xmlcharrefreplace")  # of odd file names


def picture(caption: str, image: np.ndarray) -> Picture:
    """Embed an 8-bit image (H, W, 3)."""
    return _webp(caption, [image], quality=92)


def animation(caption: str, images: Sequence[np.ndarray]) -> Picture:
    """Embed 8-bit images (H, W, 3) as an endless video."""
    return _webp(caption, images, quality=88, duration=100, loop=0)


def _webp(caption: str, images: Sequence[np.ndarray], **options: int) -> Picture:
    from PIL import Image

    first, *rest = (Image.fromarray(image) for image in images)
    if rest:
        options |= {"save_all": True, "append_images": rest}
    buffer = io.BytesIO()
    first.save(buffer, "WEBP", **options)
    text = base64.b64encode(buffer.getvalue()).decode()
    return Picture(caption, f"data:image/webp;base64,{text}")
