"""Read a picture as a mask: choose the channel or colour that marks the person.

=========================================  ====================================================
Picture                                    Inside
=========================================  ====================================================
with alpha that is somewhere below 255     its alpha
a palette, used in black and white alone   white, wherever in the palette it stands
a palette of greys                         its luminance
any other palette                          its labels; 255 beside others is a border, and zero
grey, and RGB that is grey                 its luminance
one colour before black, hard or soft      how much of that colour
more colours                               refused: a photograph, or a drawing of labels
=========================================  ====================================================

Alpha that is 255 everywhere is ignored: some programs always add it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gva_mi.core.errors import InputError

if TYPE_CHECKING:
    from PIL import Image

GREY = 32  # largest difference of a grey pixel's channels, after JPEG
ALIKE = 48  # largest difference of a pixel from its share of the one colour, likewise
STRAY = 0.02  # share of coloured pixels that may differ more: at edges JPEG blurs colour
DARK = 64  # black, after JPEG
VOID = 255  # label of pixels that are nobody's, round each object of PASCAL VOC's drawings


def matte_of(where: str, image: Image.Image) -> np.ndarray:
    """Convert an 8-bit picture to a mask (H, W) 8-bit, 255 inside; ``where`` names it in errors.

    Labels of a palette are returned as they are: :mod:`.masks` says what they mean.
    """
    if image.mode in ("LA", "La", "RGBA", "RGBa", "PA") or (
        image.mode == "P" and "transparency" in image.info
    ):
        alpha = np.asarray(image.convert("RGBA").getchannel("A"))
        if alpha.min(initial=255) < 255:
            return alpha
    if image.mode in ("P", "PA"):
        return _of_palette(image)
    if image.mode in ("1", "L", "LA", "La"):
        return np.asarray(image.convert("L"))
    return matte_of_pixels(where, np.asarray(image.convert("RGB")))


def matte_of_pixels(where: str, pixels: np.ndarray) -> np.ndarray:
    """Convert 8-bit pixels (H, W, 3) RGB or (H, W, 4) RGBA, such as a film's, to a mask."""
    if pixels.shape[2] == 4 and pixels[..., 3].min(initial=255) < 255:
        return np.ascontiguousarray(pixels[..., 3])
    from PIL import Image

    rgb = np.ascontiguousarray(pixels[..., :3])
    most = rgb.max(axis=2)
    if not (most - rgb.min(axis=2) > GREY).any():
        return np.asarray(Image.fromarray(rgb).convert("L"))
    bright = most > 127
    color = rgb[bright].mean(axis=0) if bright.any() else np.zeros(3)
    if color.max() - color.min() > GREY and most.min() < DARK:
        some = most >= DARK
        share = most[some, None] * (color / color.max())
        if (np.abs(rgb[some] - share).max(axis=1) > ALIKE).mean() <= STRAY:
            return np.clip(np.round(most * (255 / color.max())), 0, 255).astype(np.uint8)
    raise InputError(
        f"{where}: a mask in several colours, such as a photograph or a drawing of labels, does "
        "not say what is inside; expected white, or one colour, before black; or alpha"
    )


def _of_palette(image: Image.Image) -> np.ndarray:
    """Return the values of a palette picture: colours if all that is used is grey, else labels."""
    labels = np.array(image if image.mode == "P" else image.getchannel(0))
    colors = np.asarray(image.convert("RGB"))
    if (colors == colors[..., :1]).all():
        return np.ascontiguousarray(colors[..., 0])
    used = np.unique(labels[labels > 0])
    if len(used) > 1 and used[-1] == VOID:
        labels[labels == VOID] = 0
    return labels
