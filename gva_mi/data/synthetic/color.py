"""Colours: sRGB as it is stored, and linear albedo, Rec. 709 primaries."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

Color = tuple[float, float, float]  # linear albedo


def linear(*srgb: int) -> Color:
    """An 8-bit sRGB colour, three numbers from 0 to 255, as linear albedo."""
    c = np.array(srgb, dtype=np.float64) / 255
    return tuple(float(x) for x in np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4))


def encode(linear_rgb: np.ndarray) -> np.ndarray:
    """Linear light as sRGB encodes it, in [0, 1], float32."""
    x = np.clip(linear_rgb, 0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055).astype(np.float32)


def palette(rng: np.random.Generator, colors: Sequence[Color]) -> Color:
    """One of some colours, slightly varied."""
    color = np.array(colors[rng.integers(len(colors))])
    return tuple(float(c) for c in np.clip(color * rng.uniform(0.85, 1.15, 3), 0.01, 0.85))
