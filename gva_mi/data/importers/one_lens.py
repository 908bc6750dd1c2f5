"""Compare places of people whom an estimator saw through another lens in each frame.

A network that sees a crop assumes a long lens with its axis in the crop: focal length, axis and
distance breathe with the detector's box, by metres while a person stands still. So places are
compared, joined and interpolated before one usual lens. With f the geometric mean of a lens's focal
lengths and u the pixel where a place x is seen,

1. ``z' = z f' / f``
2. ``x' = (u − c') z' / f'``, y alike

is the place at the same pixel, with as many pixels a metre, before the lens f', c'.
"""

from __future__ import annotations

import numpy as np

ONE_LENS = 1e-3  # by which entries of K may differ, as a share of the focal length


def usual_lens(K: np.ndarray) -> np.ndarray:
    """Return K (3, 3) of a lens that is likely for pictures that lenses (n, 3, 3) belong to.

    Its axis is where theirs is on the median. A picture of twice that is seen under 53 degrees
    along its diagonal, as by a camera of 43 mm.
    """
    cx, cy = np.median(K[:, :2, 2], axis=0)
    focal = 2 * max(np.hypot(cx, cy), 1.0)
    return np.array([[focal, 0, cx], [0, focal, cy], [0, 0, 1]])


def is_one_lens(K: np.ndarray) -> bool:
    """Whether lenses (n, 3, 3) are the same in all frames."""
    return bool(np.ptp(K, axis=0).max() <= ONE_LENS * K[0, 0, 0])


def seen_alike(places: np.ndarray, K: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return where (n, 3) metres through the lens ``other`` shows the picture of ``K`` (eq. 1, 2).

    ``places`` are (n, 3); both lenses (3, 3) or (n, 3, 3).
    """
    K, other = (np.broadcast_to(x, (len(places), 3, 3)) for x in (K, other))
    f, axes, middle = _parts(K)
    f_other, axes_other, middle_other = _parts(other)
    z = places[:, 2:] * (f_other / f)
    with np.errstate(divide="ignore", invalid="ignore"):  # a place in the plane of the lens
        pixels = places[:, :2] * axes / places[:, 2:] + middle - middle_other
    return np.concatenate([pixels * z / axes_other, z], axis=1)


def _parts(K: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return f (n, 1), both focal lengths (n, 2) and the axis (n, 2) of lenses (n, 3, 3)."""
    axes = K[:, [0, 1], [0, 1]]
    return np.sqrt(axes.prod(1, keepdims=True)), axes, K[:, :2, 2]
