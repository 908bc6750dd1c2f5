"""How much of each pixel at the outline is the person.

A pixel there mixes the person's colour F and the background's B:

1. ``I = a F + (1 - a) B``,   so   ``a = <I - B, F - B> / |F - B|^2``
2. its variance is   ``v = (n^2 + a^2 V) / |F - B|^2``

with the noise n of a colour and the variance V of the person's colours around. F is their mean
just inside. B is the plate, times the shade s that is seen just outside; where the plate is a guess
it is the mean colour just outside. The cut says something, too: blurred a little, it is another
estimate of a, whose variance w falls with the distance from the cut. The result is the mean of
both, weighted by the inverse variances.
"""

from __future__ import annotations

import numpy as np

from gva_mi.data.matting.plate import Plate

BAND = 3  # pixels on each side of the cut whose share is open
REACH = 7  # pixels, side of the squares whose means are F, s and the colour outside
BORDER = BAND + REACH + 2  # pixels around the person that have to be in the picture
BLUR = 0.6  # pixels, of the cut
DOUBT, FADES = 0.2, 1.2  # square root of w at the cut; pixels in which it falls to a share 1 / e
NOISE = 0.02  # n


def outline_alpha(image: np.ndarray, inside: np.ndarray, plate: Plate) -> np.ndarray:
    """Return the person's share (h, w) float32 of a picture (h, w, 3) in [0, 1].

    ``inside`` (h, w) bool is the cut.
    """
    from scipy.ndimage import distance_transform_edt, gaussian_filter

    away = distance_transform_edt(inside) + distance_transform_edt(~inside) - 0.5
    open_ = away < BAND
    alpha = inside.astype(np.float32)
    if not open_.any() or inside.all():
        return alpha
    blurred = gaussian_filter(alpha, BLUR)
    sure, bare = inside & ~open_, ~inside & ~open_
    F, V = _mean_around(image, sure)
    outside, _ = _mean_around(image, bare)
    B = plate.color
    shade = np.einsum("ijk,ijk->ij", image, B) / (np.einsum("ijk,ijk->ij", B, B) + 1e-3)
    s, _ = _mean_around(shade[..., None].clip(0.2, 1.3), bare & plate.seen)
    B = np.where(plate.seen[..., None], s * B, outside)
    span = np.einsum("ijk,ijk->ij", F - B, F - B) + 1e-6
    share = (np.einsum("ijk,ijk->ij", image - B, F - B) / span).clip(0, 1)
    doubt = (NOISE**2 + share**2 * V) / span
    w = (DOUBT * np.exp(-away / FADES)) ** 2
    mixed = (share * w + blurred * doubt) / (w + doubt)
    return np.where(open_, mixed, alpha).astype(np.float32)


def _mean_around(values: np.ndarray, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return mean (h, w, C) and variance (h, w), of all channels, of known values near each pixel.

    A pixel without a known value in its square takes those of the nearest that has one.
    """
    from scipy.ndimage import distance_transform_edt, uniform_filter

    blur = lambda x: uniform_filter(x, (REACH, REACH, 1)[: x.ndim], mode="constant")
    weight = known.astype(np.float32)
    total = blur(weight)
    found = total > 0.5 / REACH**2
    if not found.any():
        return np.zeros_like(values), np.ones(known.shape, np.float32)
    total = np.maximum(total, 1e-6)
    mean = blur(values * weight[..., None]) / total[..., None]
    square = blur((values**2).sum(-1) * weight) / total
    variance = np.maximum(square - (mean**2).sum(-1), 0)
    if not found.all():
        nearest = distance_transform_edt(~found, return_distances=False, return_indices=True)
        mean, variance = mean[tuple(nearest)], variance[tuple(nearest)]
    return mean, variance
