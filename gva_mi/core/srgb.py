"""The transfer function of sRGB: between values of pictures and linear light."""

from __future__ import annotations

import numpy as np


def decoded(values: np.ndarray) -> np.ndarray:
    """Convert sRGB values to linear light, any shape; [0, 1] stays [0, 1].

    Example:
        >>> decoded(np.array([0.0, 0.5, 1.0])).round(3)
        array([0.   , 0.214, 1.   ])
    """
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def encoded(light: np.ndarray) -> np.ndarray:
    """Convert linear light, at least 0, to sRGB values, any shape.

    Example:
        >>> encoded(np.array([0.0, 0.214, 1.0])).round(3)
        array([0. , 0.5, 1. ])
    """
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)
