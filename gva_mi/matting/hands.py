"""Where a person's hands and forearms are in a picture, by landmarks: bones with a certainty.

How near a pixel is to bones of certainties c_k, at distances d_k from it, is

1. ``n(r) = max_k c_k exp(-d_k^2 / (2 r^2))``

A hand that was not found, or is out of the picture, has no bones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gva_mi.body.pose import SIDES
from gva_mi.matting.camera import WorkGrid
from gva_mi.subject.landmarks import Landmarks, hand_names

REACH = 3.0  # radii r beyond which n is 0: there it is below 0.012
_FINGERS = ("thumb", "index", "middle", "ring", "pinky")
_ROOTS = ("index", "middle", "ring", "pinky")  # whose first joints are the palm's far side


def _hand_bones(side: str) -> list[tuple[str, str]]:
    """Return the ends of a hand's bones: along each finger from the wrist, and across the palm."""
    names = hand_names(side)
    fingers = [[x for x in names if f"_{finger}_" in x] for finger in _FINGERS]
    chains = [[names[0], *finger] for finger in fingers]
    chains.append([finger[0] for finger in fingers if finger[0].split("_")[2] in _ROOTS])
    return [pair for chain in chains for pair in zip(chain[:-1], chain[1:], strict=True)]


_BONES = [
    pair
    for side in SIDES
    for pair in [*_hand_bones(side), (f"{side}_elbow", f"{side}_wrist")]
]  # fmt: skip


@dataclass(frozen=True)
class Bones:
    """N bones of hands and forearms in a picture."""

    ends: np.ndarray  # (N, 2, 2) pixels x, y of both ends; the centre of the first is (0.5, 0.5)
    certainty: np.ndarray  # (N,) in [0, 1]: c, of the less certain end

    @staticmethod
    def of(landmarks: Landmarks, frame: int, grid: WorkGrid) -> Bones:
        """Return the bones that were found in a frame, in pixels of the working grid."""
        place = {name: k for k, name in enumerate(landmarks.names)}
        known = [pair for pair in _BONES if set(pair) <= place.keys()]
        index = np.array([[place[name] for name in pair] for pair in known], int).reshape(-1, 2)
        ends = (landmarks.pixels[frame, index] - grid.box[:2]) * grid.scale
        found = np.isfinite(ends).all((1, 2))
        return Bones(ends[found], landmarks.confidence[frame, index].min(1)[found])

    def near(self, shape: tuple[int, int], radius: float) -> np.ndarray:
        """Return n(radius) (h, w) float32, eq. 1; the radius is in pixels."""
        n = np.zeros(shape, np.float32)
        for (a, b), certainty in zip(self.ends, self.certainty, strict=True):
            low = np.floor(np.minimum(a, b) - REACH * radius).clip(0, shape[::-1]).astype(int)
            high = np.ceil(np.maximum(a, b) + REACH * radius).clip(0, shape[::-1]).astype(int)
            part = slice(low[1], high[1]), slice(low[0], high[0])
            y, x = np.mgrid[part] + 0.5
            along = b - a
            share = ((x - a[0]) * along[0] + (y - a[1]) * along[1]) / max(along @ along, 1e-9)
            share = share.clip(0, 1)
            square = (x - a[0] - share * along[0]) ** 2 + (y - a[1] - share * along[1]) ** 2
            close = np.where(square < (REACH * radius) ** 2, np.exp(-square / (2 * radius**2)), 0)
            n[part] = np.maximum(n[part], certainty * close)
        return n
