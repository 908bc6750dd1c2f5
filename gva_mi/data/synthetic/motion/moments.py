"""When: a motion is a function of the time t, in rounds of the video."""

from __future__ import annotations

import numpy as np

DURATION = 6.0  # s, one round
STEP = 0.04  # s, between the moments that a lag depends on


def times(frames: int) -> np.ndarray:
    """The moments of a video's frames (T,), in rounds."""
    return np.arange(frames) / frames


def before(t: np.ndarray, steps: int) -> np.ndarray:
    """The moments some steps of ``STEP`` seconds earlier."""
    return t - steps * STEP / DURATION
