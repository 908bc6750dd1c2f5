"""The smoothest cut of a picture into person and background, as a Dr.Jit kernel.

With log odds L of being the person and the price g of an outline between two pixels, the set
``{u = 1}`` that minimises

1. ``E(u) = sum g |grad u| - sum L u``,   ``0 <= u <= 1``

is the minimum cut: the relaxation to fractions is exact, and any threshold of u gives an optimum
(Chan, Esedoglu and Nikolova 2006). It is found by the primal-dual iteration of Chambolle and Pock
(2011), whose dual variable p has ``|p| <= g``:

2. ``p <- project(p + s grad v)``
3. ``u' = clip(u + s (div p + L), 0, 1)``,   ``v = 2 u' - u``

Between the last column and the first one of the next row, and below the last row, g is zero, hence
p. So no pixel is special.
"""

from __future__ import annotations

import drjit as dr
import numpy as np
from drjit.llvm import Float, UInt32

from gva_mi.jit.frozen import Frozen, exclusive

STEP_SIZE = 0.35  # s of eq. 2 and 3; converges if s² |grad|² <= 1, and |grad|² <= 8


@exclusive
def smoothest_cut(
    odds: np.ndarray, price: tuple[np.ndarray, np.ndarray], start: np.ndarray, steps: int
) -> np.ndarray:
    """Return u (H, W) in [0, 1], nearly binary, that minimises eq. 1.

    Args:
        odds: L (H, W), log odds of the person.
        price: g of an outline between a pixel and its right neighbour (H, W - 1), and between
            a pixel and the one below (H - 1, W), in the odds' unit.
        start: u to start from (H, W).
        steps: iterations.
    """
    right, below = price
    g = [np.pad(right, ((0, 0), (0, 1))), np.pad(below, ((0, 1), (0, 0)))]
    u, L, *g = (Float(x.astype(np.float32).ravel()) for x in (start, odds, *g))
    count, *apart = (dr.opaque(UInt32, n) for n in (odds.size, 1, odds.shape[1]))
    return np.array(_minimise(u, L, g, count, apart, steps=steps)).reshape(odds.shape)


@Frozen
def _minimise(
    u: Float, L: Float, g: list[Float], count: UInt32, apart: list[UInt32], *, steps: int
) -> Float:
    """Iterate eq. 2 and 3 on ``count`` pixels, ``apart`` from their right and lower neighbours."""
    lane = dr.arange(UInt32, dr.width(u))
    v, p = u, [0 * x for x in g]
    for _ in range(steps):
        ahead = [dr.gather(Float, v, lane + n, lane + n < count) for n in apart]
        p = [
            dr.clip(p_n + STEP_SIZE * (v_n - v), -g_n, g_n)
            for p_n, v_n, g_n in zip(p, ahead, g, strict=True)
        ]
        dr.eval(p)
        moved = L
        for p_n, n in zip(p, apart, strict=True):
            moved = moved + p_n - dr.gather(Float, p_n, lane - n, lane >= n)
        moved = dr.clip(u + STEP_SIZE * moved, 0, 1)
        u, v = moved, 2 * moved - u
        dr.eval(u, v)
    return u
