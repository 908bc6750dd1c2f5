"""The person's outline: the smoothest cut, and how much of each pixel at it is the person.

With log odds L of being the person and the price g of an outline between two pixels, the set
``{u = 1}`` that minimises

1. ``E(u) = sum g |grad u| - sum L u``,   ``0 <= u <= 1``

is the minimum cut: the relaxation to fractions is exact, and any threshold of u gives an optimum
(Chan, Esedoglu and Nikolova 2006). It is found by the primal-dual iteration of Chambolle and Pock
(2011), whose dual variable p has ``|p| <= g``:

2. ``p <- project(p + s grad v)``
3. ``u' = clip(u + t (div p + L), 0, 1)``,   ``v = 2 u' - u``

A pixel there mixes the person's colour F and the background's B:

4. ``I = a F + (1 - a) B``,   so   ``a = <I - B, F - B> / |F - B|^2``
5. its variance is   ``v = (n^2 + a^2 V) / |F - B|^2``

with the noise n of a colour and the variance V of the person's colours around. F is their mean just
inside, and B is the background, in the shade that is seen just outside
(:meth:`gva_mi.data.matting.plate.Plate.beside`). The cut says something, too: blurred a little, it
is another estimate of a, whose variance w falls with the distance from the cut. The result is the
mean of both, weighted by the inverse variances.
"""

from __future__ import annotations

import numpy as np

from gva_mi.data.matting.plate import REACH, Plate, mean_around

STEP = 0.35  # s = t; s t |grad|^2 <= 1 is needed, and |grad|^2 <= 8


def smoothest_cut(
    odds: np.ndarray, price: tuple[np.ndarray, np.ndarray], start: np.ndarray, steps: int
) -> np.ndarray:
    """Return u (H, W) in [0, 1], nearly binary, that minimises eq. 1.

    Args:
        odds: L (H, W) float32, log odds of the person.
        price: g of an outline between a pixel and its right neighbour (H, W - 1), and between
            a pixel and the one below (H - 1, W), in the odds' unit.
        start: u to start from (H, W).
        steps: iterations.
    """
    right, below = (x.astype(np.float32) for x in price)
    u = start.astype(np.float32)
    v, moved = u.copy(), np.empty_like(u)
    p, q = np.zeros_like(right), np.zeros_like(below)
    step_p, step_q, least_p, least_q = np.empty_like(p), np.empty_like(q), -right, -below
    for _ in range(steps):
        p += np.multiply(np.subtract(v[:, 1:], v[:, :-1], out=step_p), STEP, out=step_p)
        q += np.multiply(np.subtract(v[1:], v[:-1], out=step_q), STEP, out=step_q)
        np.minimum(np.maximum(p, least_p, out=p), right, out=p)  # half of the time of np.clip
        np.minimum(np.maximum(q, least_q, out=q), below, out=q)
        moved[:] = odds
        moved[:, :-1] += p
        moved[:, 1:] -= p
        moved[:-1] += q
        moved[1:] -= q
        moved *= STEP
        moved += u
        np.minimum(np.maximum(moved, 0, out=moved), 1, out=moved)
        np.subtract(np.multiply(moved, 2, out=v), u, out=v)
        u, moved = moved, u
    return u


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
