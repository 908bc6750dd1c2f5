"""Frames with the outlines of mask and body over them: what a report's figures look like."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gva_mi.body.smplx import BodyModel
from gva_mi.data.check.contents import Contents
from gva_mi.data.check.seen import Seen, Silhouettes
from gva_mi.data.check.silhouettes import Compared
from gva_mi.data.video import spread
from gva_mi.mesh.overlay import OUTLINE, outlined, strip

SHOWN = 6  # frames
HEIGHT = 360  # px
CAPTION = 20  # px, height of a line of text
MASK = (0.1, 0.75, 0.35)  # green, beside the body's orange


def draw_sheet(contents: Contents, compared: Compared, body: BodyModel) -> np.ndarray:
    """The sheet, (h, w, 3) float32: the plain reading, and the one that fits in a row below.

    Args:
        contents: of the folder.
        compared: what was looked at.
        body: that is drawn.
    """
    renderer = Silhouettes(body)
    legend = "orange: body, green: mask"
    rows = [_captioned(_row(contents, compared.some, renderer), f"as it is; {legend}")]
    if compared.accepted:
        how = ", ".join(reading.what for reading in compared.accepted)
        # Where masks are other ones, or elsewhere, the pictures on disk do not go with them.
        moved = any(reading.moves_pictures for reading in compared.accepted)
        shown = _row(None if moved else contents, compared.final, renderer)
        rows.append(_captioned(shown, f"read without: {how}"))
    width = max(row.shape[1] for row in rows)
    padded = [np.pad(r, ((0, 0), (0, width - r.shape[1]), (0, 0)), constant_values=1) for r in rows]
    return np.concatenate(padded)


def _row(contents: Contents | None, seen: Seen, renderer: Silhouettes) -> list[np.ndarray]:
    """Some frames, or white without contents, with both outlines."""
    some = seen.of(spread(range(len(seen)), SHOWN))
    first = some.cameras[0]
    size = max(1, round(HEIGHT * first.width / first.height)), HEIGHT
    large = replace(some, cameras=tuple(c.resized(*size) for c in some.cameras))
    shown = renderer.render(large)[..., 3] > 0.5
    pictures = []
    for i, frame in enumerate(some.frames):
        picture = np.ones((size[1], size[0], 3), np.float32)
        if contents is not None:
            picture = _resized(contents.picture(frame), size).astype(np.float32) / 255
        mask = _resized(some.masks[i].astype(np.uint8) * 255, size) > 127
        pictures.append(outlined(outlined(picture, mask, MASK), shown[i], OUTLINE))
    return pictures


def _resized(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    from PIL import Image

    return np.asarray(Image.fromarray(image).resize(size, Image.Resampling.BILINEAR))


def _captioned(pictures: list[np.ndarray], text: str) -> np.ndarray:
    """Pictures beside each other under a line of text."""
    from PIL import Image, ImageDraw, ImageFont

    row = strip([pictures])
    line = Image.new("RGB", (row.shape[1], CAPTION), "white")
    ImageDraw.Draw(line).text((4, 2), text, "black", ImageFont.load_default(size=14))
    return np.concatenate([np.asarray(line, np.float32) / 255, row])
