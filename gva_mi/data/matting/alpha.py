"""How much of each pixel at the outline is the person.

A pixel there mixes the person's colour F and the background's B:

1. ``I = a F + (1 - a) B``,   so   ``a = <I - B, F - B> / |F - B|^2``
2. its variance is   ``v = (n^2 + a^2 V) / |F - B|^2``

with the noise n of a colour and the variance V of the person's colours around. F is their mean just
inside, and B is the background, in the shade that is seen just outside
(:meth:`gva_mi.data.matting.plate.Plate.beside`). The cut says something, too: blurred a little, it
is another estimate of a, whose variance w falls with the distance from the cut. The result is the
mean of both, weighted by the inverse variances.
"""

from __future__ import annotations

import numpy as np

from gva_mi.data.matting.plate import REACH, Plate, mean_around

BAND = 3  # pixels on each side of the cut whose share is open
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
    F, V = mean_around(image, sure)
    B = plate.beside(image, bare)
    span = np.einsum("ijk,ijk->ij", F - B, F - B) + 1e-6
    share = (np.einsum("ijk,ijk->ij", image - B, F - B) / span).clip(0, 1)
    doubt = (NOISE**2 + share**2 * V) / span
    w = (DOUBT * np.exp(-away / FADES)) ** 2
    mixed = (share * w + blurred * doubt) / (w + doubt)
    return np.where(open_, mixed, alpha).astype(np.float32)
