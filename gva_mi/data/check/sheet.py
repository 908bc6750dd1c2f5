"""The picture sheet: frames with the outlines of mask and body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from gva_mi.body.smplx import BodyModel
from gva_mi.data.check.files import SubjectFiles
from gva_mi.data.check.frames import CheckedFrames, SilhouetteRenderer
from gva_mi.data.check.silhouettes import SilhouetteCheck
from gva_mi.data.splits import spread
from gva_mi.mesh.overlay import OUTLINE, outlined, strip

SHOWN = 6  # frames
HEIGHT = 360  # px
CAPTION = 20  # px, height of a line of text
MASK = (0.1, 0.75, 0.35)  # green, beside the body's orange


def draw_sheet(files: SubjectFiles, shown: SilhouetteCheck, body: BodyModel) -> np.ndarray:
    """Draw the sheet, (h, w, 3) float32: the folder as it is, and a row with faults corrected."""
    renderer = SilhouetteRenderer(body)
    rows = [_captioned(_row(files, shown.frames, renderer), "as it is; orange: body, green: mask")]
    if shown.accepted:
        how = ", ".join(hypothesis.what for hypothesis in shown.accepted)
        # If masks are others, or elsewhere, the pictures on disk do not go with them.
        moved = any(hypothesis.moves_pictures for hypothesis in shown.accepted)
        row = _row(None if moved else files, shown.final, renderer)
        rows.append(_captioned(row, f"read without: {how}"))
    width = max(row.shape[1] for row in rows)
    padded = [np.pad(r, ((0, 0), (0, width - r.shape[1]), (0, 0)), constant_values=1) for r in rows]
    return np.concatenate(padded)


def _row(
    files: SubjectFiles | None, frames: CheckedFrames, renderer: SilhouetteRenderer
) -> list[np.ndarray]:
    """Return some frames (white if files are missing) with both outlines."""
    some = frames.of(spread(range(len(frames)), SHOWN))
    first = some.cameras[0]
    size = max(1, round(HEIGHT * first.width / first.height)), HEIGHT
    large = replace(some, cameras=tuple(c.resized(*size) for c in some.cameras))
    bodies, pictures = renderer.silhouettes(large), []
    for number, mask, body in zip(some.numbers, some.masks, bodies, strict=True):
        picture = np.ones((size[1], size[0], 3), np.float32)
        if files is not None:
            picture = _resized(files.picture(number), size).astype(np.float32) / 255
        mask = _resized(mask.astype(np.uint8) * 255, size) > 127
        pictures.append(outlined(outlined(picture, mask, MASK), body, OUTLINE))
    return pictures


def _resized(image: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    from PIL import Image

    return np.asarray(Image.fromarray(image).resize(size, Image.Resampling.BILINEAR))


def _captioned(pictures: list[np.ndarray], text: str) -> np.ndarray:
    """Return pictures beside each other under a line of text."""
    from PIL import Image, ImageDraw, ImageFont

    row = strip([pictures])
    line = Image.new("RGB", (row.shape[1], CAPTION), "white")
    ImageDraw.Draw(line).text((4, 2), text, "black", ImageFont.load_default(size=14))
    return np.concatenate([np.asarray(line, np.float32) / 255, row])
