"""Colours of a film's pictures: sRGB of 8 bits, whatever the film was recorded in.

* **Matrix and range** follow the film's tags. Without a tag, a film of at least 720 rows or 1280
  columns is BT.709, a smaller one BT.601, as players take it.
* **HDR** (PQ of SMPTE ST 2084, HLG of BT.2100), as phones record it, becomes light in units of the
  reference white, 203 cd/m² (BT.2408). BT.2020's primaries become those of sRGB. Light x of the
  brightest channel is compressed above a knee k, and the others by the same factor:

  1. ``f(x) = x`` below k,  ``k + (1 − k) (1 − exp(−(x − k) / (1 − k)))`` above.

* **SDR with BT.2020's primaries** changes primaries alone.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import av

PQ, HLG, BT2020, UNTAGGED = 16, 18, 9, (0, 2)  # ITU-T H.273: transfers; primaries and matrix
HDR = {PQ: "PQ", HLG: "HLG"}
REFERENCE_WHITE, PEAK = 203.0, 1000.0  # cd/m²; the peak of a display that HLG is meant for
KNEE = 0.7  # of eq. 1
WIDE, TALL = 1280, 720  # pixels: an untagged film of this size is BT.709
# Linear BT.2020 to linear BT.709, ITU-R BT.2087.
FROM_2020 = np.array(
    [[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]], np.float32
)
LUMA_2020 = np.array([0.2627, 0.6780, 0.0593], np.float32)


def rgb_of(
    frame: av.VideoFrame, converter: av.video.reformatter.VideoReformatter | None = None
) -> np.ndarray:
    """Return a frame as sRGB, (H, W, 3) 8-bit, not turned; it may share the frame's memory.

    ``converter`` is reused for frames alike; each keeps tables.
    """
    from av.video.reformatter import Colorspace, VideoReformatter

    wide_gamut = frame.color_primaries == BT2020
    matrix = None
    if frame.colorspace in UNTAGGED and not frame.format.is_rgb:
        large = max(frame.width, frame.height) >= WIDE or min(frame.width, frame.height) >= TALL
        matrix = Colorspace.BT2020 if wide_gamut else Colorspace.ITU709 if large else None
    # More than 8 bits go by 16: the converter would cut them off, up to 2 levels too dark.
    deep = any(component.bits > 8 for component in frame.format.components)
    kind = "rgb48le" if deep or wide_gamut or frame.color_trc in HDR else "rgb24"
    found = (converter or VideoReformatter()).reformat(frame, format=kind, src_colorspace=matrix)
    pixels = found.to_ndarray()
    if kind == "rgb24":
        return pixels
    if not wide_gamut and frame.color_trc not in HDR:
        return _in_8_bits(False)[pixels]
    table, gamma = _light_of(frame.color_trc)
    light = table[pixels]
    if gamma != 1:  # HLG: a display's contrast depends on the luminance of the scene
        light *= np.maximum(light @ LUMA_2020, 1e-6)[..., None] ** (gamma - 1)
        light *= PEAK / REFERENCE_WHITE
    light = np.maximum(light @ FROM_2020.T, 0)
    if frame.color_trc in HDR:
        most = np.maximum(light.max(axis=2), KNEE)
        light *= ((KNEE + (KNEE - 1) * np.expm1((KNEE - most) / (1 - KNEE))) / most)[..., None]
    return _in_8_bits(True)[np.round(np.minimum(light, 1) * 65535).astype(np.uint16)]


@lru_cache
def _light_of(transfer: int) -> tuple[np.ndarray, float]:
    """Return linear light of all 16-bit values, (65536,) float32, and the exponent for HLG.

    PQ in units of the reference white, HLG in [0, 1] of the scene, others as sRGB's in [0, 1].
    """
    value = np.arange(65536) / 65535
    if transfer == PQ:
        root = value ** (1 / 78.84375)
        light = np.maximum(root - 0.8359375, 0) / (18.8515625 - 18.6875 * root)
        return (1e4 / REFERENCE_WHITE * light ** (1 / 0.1593017578125)).astype(np.float32), 1.0
    if transfer == HLG:
        a, b, c = 0.17883277, 0.28466892, 0.55991073
        light = np.where(value <= 0.5, value**2 / 3, (np.exp((value - c) / a) + b) / 12)
        return light.astype(np.float32), 1.2
    light = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    return light.astype(np.float32), 1.0


@lru_cache
def _in_8_bits(linear: bool) -> np.ndarray:
    """Return the 8-bit values (65536,) of sRGB's values, or of linear light, in 16 bits."""
    if not linear:
        return np.round(np.arange(65536) / 257).astype(np.uint8)
    x = np.arange(65536) / 65535
    value = np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
    return np.round(255 * value).astype(np.uint8)
