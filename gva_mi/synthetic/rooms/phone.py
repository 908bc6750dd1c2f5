"""The film that a phone makes of pictures: noise of the sensor, then compression.

1. ``noisy = picture + N(0, σ²)``,  ``σ = σ₀ · (1 − 0.5 · picture)``

in encoded values: noise of photons, on sRGB's curve, is weaker where it is bright. H.264 follows,
at the bits per pixel of phones.
"""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import numpy as np

from gva_mi.core.atomic import atomic_write

NOISE = (1.0, 3.5)  # grey levels of 255: σ₀ of a film
BITS = 0.27  # a pixel, as of 17 Mbit/s for 1920 x 1080 at 30 a second
LEAST = 10_000  # bits a second that the encoder accepts
# Always one thread; mbtree reads uninitialised memory: see gva_mi.data.pictures.
OPTIONS = {"threads": "1", "mbtree": "0", "preset": "veryfast"}


def write_phone_film(
    path: Path, pictures: Iterable[np.ndarray], fps: Fraction, rng: np.random.Generator
) -> None:
    """Write pictures (H, W, 3) 8-bit, of even sides, as an .mp4 of H.264 with BT.709 colours."""
    import av
    from av.video.reformatter import ColorRange, Colorspace

    strength = rng.uniform(*NOISE)
    with atomic_write(path) as unfinished, av.open(str(unfinished), "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=fps)
        stream.pix_fmt, stream.options = "yuv420p", OPTIONS
        context = stream.codec_context
        context.colorspace, context.color_primaries, context.color_trc = 1, 1, 1
        context.color_range = ColorRange.MPEG
        for k, picture in enumerate(pictures):
            if k == 0:
                stream.height, stream.width = picture.shape[:2]
                bits = int(BITS * picture.shape[0] * picture.shape[1] * fps)
                stream.bit_rate = max(bits, LEAST)
            value = picture.astype(np.float32)
            noise = rng.standard_normal(picture.shape, dtype=np.float32)
            value += strength * (1 - value / 510) * noise
            noisy = np.round(np.clip(value, 0, 255)).astype(np.uint8)
            frame = av.VideoFrame.from_ndarray(noisy, "rgb24").reformat(
                format="yuv420p", dst_colorspace=Colorspace.ITU709, dst_color_range=ColorRange.MPEG
            )
            frame.pts = None
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
