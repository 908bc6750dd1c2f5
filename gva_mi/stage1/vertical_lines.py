"""Which way is up: vertical lines of the room show how the camera is tilted.

Lines of walls, doors and shelves are vertical. Let ``(u, -1, w)`` be the direction up in the
camera's axes. In the picture, a vertical line through ``(x, y)``, in focal lengths from the
principal point, has the slope

1. ``b = dx/dy = (w x - u) / (1 + w y)``,   so   ``b = w (x - b y) - u``

which is linear in u and w. Pieces of edges whose slope is below :data:`LARGEST_SLOPE` are vertical
with the probability ``q`` and errors ``σ``, or anything else:

2. ``log p = Σ_i log(q N(b_i - w (x_i - b_i y_i) + u; 0, σ²) + (1 - q) / 2 LARGEST_SLOPE)``

The maximum of ``p`` is searched for on a grid, then by EM. Coughlan and Yuille ("Manhattan World",
Neural Computation, 2003) find the axes of a city's streets in this way, from single pixels.

Compressed pictures have edges along their blocks. So pieces are long, and have subpixel positions:
a parabola gives where the gradient along a row is largest. The person is left out, and so is
everything lower in the picture than the feet: it is the floor, whose lines run away from the
camera.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from gva_mi.subject.landmarks import Landmarks

# All are chosen by eye, unless a reason is given.
SAMPLED_FRAMES = 6  # frames of the video that are searched
BLUR_PIXELS = 1.2  # standard deviation of the blur before gradients
EDGE_CONTRAST = 0.01  # least gradient of an edge, share of the range of brightness a pixel
LARGEST_SLOPE = 0.4  # of a vertical line, |dx/dy|
PIECES_OF_HEIGHT = 16  # a piece of an edge is this fraction of the picture's height
FILLED_SHARE = 0.8  # least share of a piece's rows that have an edge
STRAIGHTNESS_PIXELS = 0.4  # largest standard deviation of a piece from its line
LANDMARKS_MARGIN = 0.12  # added around the landmarks, share of the person's height
VERTICAL_SHARE, SLOPE_SIGMA = 0.3, 0.006  # q and σ of eq. 2
U_GRID, W_GRID = np.linspace(-0.36, 0.36, 181), np.linspace(-0.6, 0.4, 101)
# Nats a frame by which eq. 2 must exceed its value without vertical lines.
FOUND_NATS = 15.0
EM_STEPS = 20  # of expectation maximisation, from the best place of the grid
PIECES_OF_LINE = 4.0  # pieces of one line err together: so many count as one
SMALLEST_SIGMA = 0.006  # least standard deviation of u and w, however many the lines


class PersonBox(NamedTuple):
    """The surroundings of a person in a picture, pixels."""

    left: float
    top: float
    right: float
    bottom: float
    feet: float  # row of the lowest landmark


@dataclass(frozen=True)
class Vertical:
    """The direction up: ``(u, -1, w)`` in the camera's axes points up."""

    up: np.ndarray  # (2,) u and w
    spread: np.ndarray  # (2,) their standard deviations


def find_vertical(
    pictures: Sequence[np.ndarray], landmarks: Landmarks, K: np.ndarray
) -> Vertical | None:
    """Find the direction up from vertical lines of the room; None if there are too few.

    Args:
        pictures: (H, W, 3) of T frames, in [0, 255], from a camera that stands still.
        landmarks: of the person, who is left out.
        K: (3, 3) the camera, pixels.
    """
    frames = np.unique(np.linspace(0, len(pictures) - 1, SAMPLED_FRAMES).round().astype(int))
    found = [_pieces(pictures[k], _person_box(landmarks, k)) for k in frames]
    x, y, b = np.concatenate(found, 1)
    x, y = (x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1]
    return _most_likely(x, y, b, len(frames))


def _person_box(landmarks: Landmarks, frame: int) -> PersonBox | None:
    """Return the person's box in a frame; None without the person."""
    points = landmarks.pixels[frame]
    points = points[np.isfinite(points).all(1)]
    if not len(points):
        return None
    margin = LANDMARKS_MARGIN * np.ptp(points[:, 1])
    low, high = points.min(0) - margin, points.max(0) + margin
    return PersonBox(*low, *high, feet=points[:, 1].max())


def _pieces(picture: np.ndarray, person: PersonBox | None) -> tuple[np.ndarray, ...]:
    """Return pieces of vertical edges: their middles x and y, pixels, and their slopes dx/dy."""
    height = max(8, len(picture) // PIECES_OF_HEIGHT)
    x, y, edge = _edges(picture.astype(np.float32).mean(2) / 255, person)
    _, of = np.unique(edge * len(picture) + y.astype(int) // height, return_inverse=True)
    total = lambda values: np.bincount(of, values)
    rows = total(np.ones(len(of)))
    middle_x, middle_y = total(x) / rows, total(y) / rows
    dx, dy = x - middle_x[of], y - middle_y[of]
    slope = total(dx * dy) / np.maximum(total(dy * dy), 1e-9)
    off = np.sqrt(total(np.square(dx - slope[of] * dy)) / rows)
    whole = (rows >= FILLED_SHARE * height) & (rows <= 1.2 * height)  # more: edges side by side
    kept = whole & (off < STRAIGHTNESS_PIXELS) & (np.abs(slope) < LARGEST_SLOPE)
    return middle_x[kept], middle_y[kept], slope[kept]


def _edges(grey: np.ndarray, person: PersonBox | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points of vertical edges: x and y, pixels, and the number of each point's edge."""
    from scipy.ndimage import gaussian_filter, label

    across, along = (gaussian_filter(grey, BLUR_PIXELS, order=order) for order in ((0, 1), (1, 0)))
    size = np.abs(across)
    before, here, after = size[:, :-2], size[:, 1:-1], size[:, 2:]
    edge = np.zeros(grey.shape, bool)
    edge[:, 1:-1] = (here > EDGE_CONTRAST) & (here >= before) & (here > after)
    edge &= np.abs(along) < LARGEST_SLOPE * size
    if person is not None:
        left, top, right, bottom, feet = (max(0, int(v)) for v in person)
        edge[top:bottom, left:right] = False
        edge[feet:] = False
    number = np.zeros(grey.shape, np.int64)
    for sign in (1, -1):  # an edge from dark to bright, and one from bright to dark
        found, _ = label(edge & (sign * across > 0), np.ones((3, 3)))
        number += np.where(found > 0, found + number.max(), 0)
    rows, columns = np.nonzero(number)
    before, here, after = (size[rows, columns + k] for k in (-1, 0, 1))
    aside = 0.5 * (before - after) / np.minimum(before - 2 * here + after, -1e-9)
    return columns + 0.5 + aside, rows + 0.5, number[rows, columns]


def _most_likely(x: np.ndarray, y: np.ndarray, b: np.ndarray, frames: int) -> Vertical | None:
    """Maximise eq. 2 over u and w, for the pieces of several frames; None if it is not certain."""
    lever, other = x - b * y, (1 - VERTICAL_SHARE) / (2 * LARGEST_SLOPE)
    normal = lambda r: np.exp(-np.square(r / SLOPE_SIGMA) / 2) / (SLOPE_SIGMA * (2 * np.pi) ** 0.5)
    odds = lambda r: VERTICAL_SHARE * normal(r) / other
    gains = np.array([np.log1p(odds(b - w * lever + U_GRID[:, None])).sum(1) for w in W_GRID])
    at_w, at_u = np.unravel_index(gains.argmax(), gains.shape)
    if (gains.max() + len(b) * np.log(1 - VERTICAL_SHARE)) / frames < FOUND_NATS:
        return None
    up, A = np.array([U_GRID[at_u], W_GRID[at_w]]), np.stack([-np.ones_like(lever), lever], 1)
    for _ in range(EM_STEPS):
        odd = odds(b - A[:, 0] * up[0] - A[:, 1] * up[1])
        weighted = A * (odd / (1 + odd))[:, None]
        square = np.einsum("ni,nj->ij", weighted, A) + 1e-6 * np.eye(2)
        up = np.linalg.solve(square, np.einsum("ni,n->i", weighted, b))
    if not (U_GRID[0] < up[0] < U_GRID[-1] and W_GRID[0] < up[1] < W_GRID[-1]):
        return None  # lines of something else
    error = SLOPE_SIGMA**2 * frames * PIECES_OF_LINE * np.diag(np.linalg.inv(square))
    return Vertical(up, np.sqrt(error + SMALLEST_SIGMA**2))
