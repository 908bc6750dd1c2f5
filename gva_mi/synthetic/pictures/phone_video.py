"""The video of a phone: noise of the sensor, then H.264 at the bits per pixel of phones.

1. ``noisy = picture + N(0, σ²)``,  ``σ = σ₀ · (1 − 0.5 · picture)``

in encoded values: noise of photons, on sRGB's curve, is weaker where it is bright.
"""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.random import Generator

from gva_mi.core.atomic import atomic_write

PHONE_VIDEO = "phone.mp4"  # in a subject's folder
SENSOR_NOISE = (1.0, 3.5)  # grey levels of 255, range of σ₀; chosen: from clean to plainly noisy
BITS_PER_PIXEL = 0.27  # chosen: 17 Mbit/s at 1920 x 1080 and 30 a second
MIN_BIT_RATE = 10_000  # bits a second, the least that the encoder accepts
# Always one thread; mbtree reads uninitialised memory: see gva_mi.subject.pictures.
ENCODER = {"threads": "1", "mbtree": "0", "preset": "veryfast"}


def write_phone_video(
    path: Path, pictures: Iterable[np.ndarray], fps: Fraction, rng: Generator
) -> None:
    """Write pictures (H, W, 3) 8-bit, of even sides, as an .mp4 of H.264 with BT.709 colours."""
    import av
    from av.video.reformatter import ColorRange, Colorspace

    strength = rng.uniform(*SENSOR_NOISE)
    with atomic_write(path) as unfinished, av.open(str(unfinished), "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=fps)
        stream.pix_fmt, stream.options = "yuv420p", ENCODER
        context = stream.codec_context
        context.colorspace, context.color_primaries, context.color_trc = 1, 1, 1
        context.color_range = ColorRange.MPEG
        for k, picture in enumerate(pictures):
            if k == 0:
                stream.height, stream.width = picture.shape[:2]
                bits = int(BITS_PER_PIXEL * picture.shape[0] * picture.shape[1] * fps)
                stream.bit_rate = max(bits, MIN_BIT_RATE)
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
