"""Random processes for errors: curves, bumps and runs in time, fields in a picture."""

from __future__ import annotations

import numpy as np


def curve(rng: np.random.Generator, frames: int, memory: float, white: float = 0.0) -> np.ndarray:
    """Draw a random curve (T, 3) of root mean square length 1.

    ``memory`` is the standard deviation, in frames, of the window that smooths its slow part, and
    ``white`` the fraction of the variance that is independent from frame to frame.
    """
    from scipy.ndimage import gaussian_filter1d

    margin = int(3 * memory)
    noise = gaussian_filter1d(rng.normal(size=(frames + 2 * margin, 3)), memory, axis=0)
    slow = _of_unit_size(noise[margin : margin + frames])
    if white == 0:
        return slow
    quick = _of_unit_size(rng.normal(size=(frames, 3)))
    return np.sqrt(1 - white) * slow + np.sqrt(white) * quick


def bumps(
    rng: np.random.Generator, frames: int, calm: float, top: float, every: float, length: float
) -> np.ndarray:
    """Draw a curve (T,) that rises from ``calm`` at least half of the way to ``top`` at random.

    Bumps are ``every`` frames apart on average, and ``length`` frames is half their length.
    """
    margin = int(3 * length)
    t = np.arange(frames)
    curve = np.full(frames, calm)
    for centre in range(-margin, frames + margin):
        if rng.random() < 1 / every:
            height = rng.uniform(0.5, 1.0) * (top - calm)
            bump = height * np.exp(-(((t - centre) / length) ** 2) / 2)
            curve = np.maximum(curve, calm + bump)
    return curve


def runs(rng: np.random.Generator, frames: int, share: float, length: float) -> np.ndarray:
    """Draw runs of frames, (T,) bool, of mean ``length``, that cover a ``share`` of all frames."""
    start = share / (length * max(1 - share, 0.1))  # probability per frame
    inside = np.zeros(frames, dtype=bool)
    for k in np.flatnonzero(rng.random(frames) < start):
        inside[k : k + rng.poisson(length - 1) + 1] = True
    return inside


def field(rng: np.random.Generator, shape: tuple[int, int], length: float) -> np.ndarray:
    """Draw a smooth random image of unit variance that varies over ``length`` pixels."""
    from scipy.ndimage import zoom

    nodes = [int(np.ceil(n / length)) + 3 for n in shape]  # a lattice to interpolate
    scale = max((n + 2 * length) / k for n, k in zip(shape, nodes, strict=True))
    fine = zoom(rng.normal(size=nodes), scale, order=3)
    top, left = ((f - n) // 2 for f, n in zip(fine.shape, shape, strict=True))
    image = fine[top : top + shape[0], left : left + shape[1]]
    return image / image.std()


def _of_unit_size(curve: np.ndarray) -> np.ndarray:
    return curve / np.sqrt((curve**2).sum(1).mean())
