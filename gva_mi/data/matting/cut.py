"""Find the smoothest outline that agrees with the evidence of each pixel.

With log odds L of being the person and the price g of an outline between two pixels, the set
``{u = 1}`` that minimises

1. ``E(u) = sum g |grad u| - sum L u``,   ``0 <= u <= 1``

is the minimum cut: the relaxation to fractions is exact, and any threshold of u gives an optimum
(Chan, Esedoglu and Nikolova 2006). It is found by the primal-dual iteration of Chambolle and Pock
(2011), whose dual variable p has ``|p| <= g``:

2. ``p <- project(p + s grad v)``
3. ``u' = clip(u + t (div p + L), 0, 1)``,   ``v = 2 u' - u``
"""

from __future__ import annotations

import numpy as np

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
