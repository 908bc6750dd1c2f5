"""Which way is up: the vertical lines of a room show it, and how a person stands.

**Lines** are those of walls, doors and shelves. The direction up in the camera's axes is that of
``(u, -1, w)``. In the picture, an upright line through ``(x, y)``, in focal lengths from the
principal point, has the slope

1. ``b = dx/dy = (w x - u) / (1 + w y)``,   so   ``b = w (x - b y) - u``

which is linear in u and w. Pieces of edges whose slope is below :data:`STEEP` are upright, with the
probability :data:`UPRIGHT` and errors ``σ``, or anything else:

2. ``log p = Σ_i log(q N(b_i - w (x_i - b_i y_i) + u; 0, σ²) + (1 - q) / 2 STEEP)``

The largest ``p`` is looked for on a grid, then by EM. Coughlan and Yuille ("Manhattan World",
Neural Computation, 2003) find the axes of a city's streets in this way, from single pixels.

Compressed pictures have edges along their blocks. Pieces are therefore long, and lie between
pixels: where the gradient along a row is largest, by a parabola. The person is left out, and so is
what is lower in the picture than the feet: that is the floor, whose lines run away from the camera.

**A person** stands with the trunk upright and the mass above the feet (:class:`Leaning`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from gva_mi.subject.landmarks import Landmarks

FRAMES = 6  # that are looked at
BLUR = 1.2  # pixels
CONTRAST = 0.01  # least gradient of an edge, of the range of brightness a pixel
STEEP = 0.4  # largest slope b of an upright line
PIECE = 16  # pieces of edges in the picture's height
FILLED = 0.8  # share of a piece's rows in which there is an edge
STRAIGHT = 0.4  # pixels, standard deviation from the line
MARGIN = 0.12  # around the landmarks, of the person's height
UPRIGHT, SIGMA = 0.3, 0.006  # q and σ of eq. 2
U, W = np.linspace(-0.36, 0.36, 181), np.linspace(-0.6, 0.4, 101)
FOUND = 15.0  # nats a frame by which eq. 2 must exceed that without upright lines
EM_STEPS = 20
TOGETHER = 4.0  # pieces of one line err together: as many count as one
EXACT = 0.006  # standard deviation that no number of lines goes below
# Shares m_j of the body's mass: each segment's, on the joints at its ends as its centre of mass
# lies between them (Winter, Biomechanics and Motor Control of Human Movement, table 4.1).
_OF_SIDES = {
    "shoulder": 0.016, "elbow": 0.021, "wrist": 0.013, "hip": 0.0567, "knee": 0.0697,
    "ankle": 0.0346,
}  # fmt: skip
MASSES = {"head": 0.081, "neck": 0.2486, "pelvis": 0.2484} | {
    f"{side}_{name}": mass for name, mass in _OF_SIDES.items() for side in ("left", "right")
}
FEET = ("left_ankle", "right_ankle")
SHARE_SPREAD = 12**-0.5  # standard deviation of s


@dataclass(frozen=True)
class Vertical:
    """The direction up, that of ``(u, -1, w)`` in the camera's axes."""

    up: np.ndarray  # (2,) u and w
    spread: np.ndarray  # (2,) their standard deviations


def vertical_of(
    pictures: Sequence[np.ndarray], landmarks: Landmarks, K: np.ndarray
) -> Vertical | None:
    """Find it in pictures (H, W, 3) of T frames, in [0, 255]; None without enough upright lines.

    ``landmarks`` are the person's, and ``K`` (3, 3) is the camera, pixels. The camera stands still.
    """
    frames = np.unique(np.linspace(0, len(pictures) - 1, FRAMES).round().astype(int))
    found = [_pieces(pictures[k], _around(landmarks, k)) for k in frames]
    x, y, b = np.concatenate(found, 1)
    x, y = (x - K[0, 2]) / K[0, 0], (y - K[1, 2]) / K[1, 1]
    return _most_likely(x, y, b, len(frames))


def _around(landmarks: Landmarks, frame: int) -> tuple[float, ...] | None:
    """Return left, top, right and bottom of the person in a frame, and the row of the feet."""
    points = landmarks.pixels[frame]
    points = points[np.isfinite(points).all(1)]
    if not len(points):
        return None
    margin = MARGIN * np.ptp(points[:, 1])
    return (*(points.min(0) - margin), *(points.max(0) + margin), points[:, 1].max())


def _pieces(
    picture: np.ndarray, person: tuple[float, ...] | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return x and y of the middles of pieces of steep edges, pixels, and their slopes dx/dy."""
    height = max(8, len(picture) // PIECE)
    x, y, edge = _edges(picture.astype(np.float32).mean(2) / 255, person)
    _, of = np.unique(edge * len(picture) + y.astype(int) // height, return_inverse=True)
    total = lambda values: np.bincount(of, values)
    rows = total(np.ones(len(of)))
    middle_x, middle_y = total(x) / rows, total(y) / rows
    dx, dy = x - middle_x[of], y - middle_y[of]
    slope = total(dx * dy) / np.maximum(total(dy * dy), 1e-9)
    off = np.sqrt(total(np.square(dx - slope[of] * dy)) / rows)
    whole = (rows >= FILLED * height) & (rows <= 1.2 * height)  # more: edges side by side
    kept = whole & (off < STRAIGHT) & (np.abs(slope) < STEEP)
    return middle_x[kept], middle_y[kept], slope[kept]


def _edges(
    grey: np.ndarray, person: tuple[float, ...] | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points x and y of steep edges, pixels, and the number of the edge of each."""
    from scipy.ndimage import gaussian_filter, label

    across, along = (gaussian_filter(grey, BLUR, order=order) for order in ((0, 1), (1, 0)))
    size = np.abs(across)
    before, here, after = size[:, :-2], size[:, 1:-1], size[:, 2:]
    edge = np.zeros(grey.shape, bool)
    edge[:, 1:-1] = (here > CONTRAST) & (here >= before) & (here > after)
    edge &= np.abs(along) < STEEP * size
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
    """Maximise eq. 2 over u and w, for pieces of several frames."""
    lever, other = x - b * y, (1 - UPRIGHT) / (2 * STEEP)
    normal = lambda r: np.exp(-np.square(r / SIGMA) / 2) / (SIGMA * (2 * np.pi) ** 0.5)
    odds = lambda r: UPRIGHT * normal(r) / other
    gains = np.array([np.log1p(odds(b - w * lever + U[:, None])).sum(1) for w in W])
    at_w, at_u = np.unravel_index(gains.argmax(), gains.shape)
    if (gains.max() + len(b) * np.log(1 - UPRIGHT)) / frames < FOUND:
        return None
    up, A = np.array([U[at_u], W[at_w]]), np.stack([-np.ones_like(lever), lever], 1)
    for _ in range(EM_STEPS):
        odd = odds(b - A[:, 0] * up[0] - A[:, 1] * up[1])
        weighted = A * (odd / (1 + odd))[:, None]
        square = np.einsum("ni,nj->ij", weighted, A) + 1e-6 * np.eye(2)
        up = np.linalg.solve(square, np.einsum("ni,n->i", weighted, b))
    if not (U[0] < up[0] < U[-1] and W[0] < up[1] < W[-1]):
        return None  # lines of something else
    error = SIGMA**2 * frames * TOGETHER * np.diag(np.linalg.inv(square))
    return Vertical(up, np.sqrt(error + EXACT**2))


def _axes() -> Tensor:
    trunk, balance, feet = ({name: 0.0 for name in MASSES} for _ in range(3))
    trunk |= {"neck": 1.0, "pelvis": -1.0}
    balance |= {name: mass - (name in FEET) / len(FEET) for name, mass in MASSES.items()}
    feet |= {"left_ankle": 1.0, "right_ankle": -1.0}
    axes = [list(axis.values()) for axis in (trunk, balance, feet)]
    return torch.tensor(axes, dtype=torch.float64)


AXES = _axes()  # (3, 15) factors of the joints of MASSES, whose sums are trunk, balance and feet


@dataclass(frozen=True)
class Leaning:
    """How the axes of trunk and balance lean in n frames of a person who stands.

    1. ``trunk = X_neck - X_pelvis``
    2. ``balance = Σ_j m_j X_j - X_feet``
       with ``X_feet = (X_left + X_right) / 2 + s (X_left - X_right)``

    The body's mass is above the feet, of people who crouch or bend as well; ``s`` is the share of
    the weight that the left foot carries beyond a half. Of all shares between zero and one, as
    likely as each other, it is the one that fits best. With ``u`` the direction up, an axis leans
    by

    3. ``off = (axis - (u · axis) u) / length``

    where ``length`` is that of the trunk, and that of ``balance`` with s = 0.

    At rest ``X_neck`` is straight above the pelvis, and the feet below the mass, because the ankles
    of a person who stands are behind it.

    Attributes:
        off: (n, 2, 3) of eq. 3.
        share: (n, 1) s.
    """

    off: Tensor
    share: Tensor
    axes: Tensor  # (n, 2, 3) metres
    length: Tensor  # (n, 2, 1) metres
    along: Tensor  # (n, 2, 3) slope of the length by the axis with s = 0
    up: Tensor  # (3,) u

    @staticmethod
    def of(X: Tensor, up: Tensor, sigma: float) -> Leaning:
        """Measure it at joints X (n, 15, 3), metres; ``sigma`` is the spread of ``off``."""
        trunk, balance, feet = torch.einsum("ap,npc->anc", AXES.to(up), X)
        level = torch.eye(3).to(up) - up[:, None] * up
        axes = torch.stack([trunk, balance], 1)
        length = axes.norm(dim=2, keepdim=True)
        off, aside = axes @ level / length, feet @ level / length[:, 1]
        share = (off[:, 1] * aside).sum(1, keepdim=True)
        share = share / (aside.square().sum(1, keepdim=True) + (sigma / SHARE_SPREAD) ** 2)
        share = share.clamp(-0.5, 0.5)
        carried = torch.stack([trunk, balance - share * feet], 1)
        return Leaning(carried @ level / length, share, carried, length, axes / length, up)

    def slopes(self, by: Tensor) -> Tensor:
        """Return the derivatives of ``off`` (n, 2, 3, U) from those of the joints (n, 15, 3, U).

        The share stays: it is the best one, and its change changes no energy.
        """
        trunk, balance, feet = torch.einsum("ap,npcu->ancu", AXES.to(by), by)
        longer = torch.einsum("nac,nacu->nau", self.along, torch.stack([trunk, balance], 1))
        by = torch.stack([trunk, balance - self.share[..., None] * feet], 1)
        level = torch.eye(3).to(by) - self.up[:, None] * self.up
        return (level @ by - self.off[..., None] * longer[:, :, None]) / self.length[..., None]

    def slopes_by_up(self, by: Tensor) -> Tensor:
        """Return the derivatives of ``off`` (n, 2, 3, U) from those of u (3, U)."""
        turned = (self.axes @ self.up)[..., None, None] * by
        turned = turned + self.up[:, None] * (self.axes @ by)[:, :, None]
        return -turned / self.length[..., None]


def above_one_another(places: Tensor) -> Tensor:
    """Move the neck above the pelvis, and the feet below the mass: joints (..., 15, 3) at rest.

    They move in z only, and linearly, so that what betas add to places moves in the same way.
    """
    names, z = list(MASSES), places[..., 2].clone()
    mass = z.new_tensor(list(MASSES.values()))
    z[..., names.index("neck")] = z[..., names.index("pelvis")]
    feet = [names.index(name) for name in FEET]
    mass[feet] = 0
    z[..., feet] = ((z @ mass) / mass.sum())[..., None]
    return torch.stack([*places[..., :2].unbind(-1), z], -1)
