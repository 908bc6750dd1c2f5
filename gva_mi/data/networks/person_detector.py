"""Find the people of a picture: MediaPipe's pose detector, a single-shot network with anchors.

For each of 2254 anchors the network gives a score and, relative to the anchor, a box around the
head and four points. Two of these count here: the middle of the hips, and the top of a circle
around the whole person, whose centre is the middle of the hips.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gva_mi.data.networks.tflite import TfliteNetwork, sigmoid
from gva_mi.data.networks.turned_square import TurnedSquare
from gva_mi.data.networks.weights import weights_file

CERTAIN = 0.5  # least score of a person
_SAME = 0.3  # overlap of boxes (IoU) of one person
_GRIDS = ((8, 2), (16, 2), (32, 6))  # stride of a grid of anchors, pixels; anchors a cell
MARGIN = 1.25  # side of the landmark network's square, relative to the circle's diameter


class PersonDetector:
    """MediaPipe's pose detector."""

    def __init__(self, folder: Path | None = None) -> None:
        """Open the network; ``folder`` holds the weights."""
        self._network = TfliteNetwork(weights_file("pose_detection.tflite", folder))
        self._anchors = _anchors(self._network.size)  # (2254, 2) in [0, 1]

    def find(self, image: np.ndarray, squares: Sequence[TurnedSquare]) -> list[TurnedSquare]:
        """Return what the landmark network should see of the people of a picture (H, W, 3) 8-bit.

        Only ``squares`` of the picture are searched, in each of which people are seen who fill a
        fifth of it or more. The most certain person comes first.
        """
        scores, boxes, points = (
            np.concatenate(x) for x in zip(*(self._see(image, s) for s in squares), strict=True)
        )
        order = np.argsort(-scores, kind="stable")
        order = order[scores[order] >= CERTAIN]
        people = []
        while len(order):  # the mean of overlapping boxes, weighted by their scores, is a person
            same = _overlap(boxes[order[0]], boxes[order]) > _SAME
            same[0] = True
            group, order = order[same], order[~same]
            hips, top = np.average(points[group], axis=0, weights=scores[group])
            radius = float(np.linalg.norm(top - hips))
            people.append(TurnedSquare.upright(hips, top, 2 * MARGIN * radius))
        return people

    def _see(
        self, image: np.ndarray, square: TurnedSquare
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return scores (2254,), boxes (2254, 4) and the points (2254, 2, 2) in the picture."""
        out = self._network(2 * square.cut(image, self._network.size, edge=False) - 1)
        values = out["Identity"].astype(np.float64) / self._network.size
        centres, sizes = values[:, :2] + self._anchors, values[:, 2:4]
        corners = square.to_picture(np.stack([centres - sizes / 2, centres + sizes / 2], axis=1))
        points = values[:, 4:8].reshape(-1, 2, 2) + self._anchors[:, None]
        scores = sigmoid(out["Identity_1"][:, 0])
        return scores, corners.reshape(-1, 4), square.to_picture(points)


def squares_over(image: np.ndarray, side: float) -> list[TurnedSquare]:
    """Return squares over a whole picture (H, W, 3), of which neighbours share a half or more."""
    height, width = image.shape[:2]
    return [
        TurnedSquare((x, y), side) for y in _middles(height, side) for x in _middles(width, side)
    ]


def _middles(length: int, side: float) -> list[float]:
    """Return the middles of the intervals that cover a length, which overlap by half or more.

    If the interval is longer than that, one around the middle covers it.
    """
    if side >= length:
        return [length / 2]
    count = math.ceil(2 * (length - side) / side) + 1
    return np.linspace(side / 2, length - side / 2, count).tolist()


def _anchors(size: int) -> np.ndarray:
    """Return the centres of the anchors (n, 2) in [0, 1], in the network's order."""
    grids = []
    for stride, each in _GRIDS:
        places = (np.arange(size // stride) + 0.5) * stride / size
        cells = np.stack(np.meshgrid(places, places), axis=-1).reshape(-1, 2)
        grids.append(np.repeat(cells, each, axis=0))
    return np.concatenate(grids)


def _overlap(box: np.ndarray, boxes: np.ndarray) -> np.ndarray:
    """Return the IoU (n,) of a box (4,) with others (n, 4): left, top, right, bottom."""
    low, high = np.maximum(box[:2], boxes[:, :2]), np.minimum(box[2:], boxes[:, 2:])
    inside = (high - low).clip(0).prod(-1)
    areas = (boxes[:, 2:] - boxes[:, :2]).clip(0).prod(-1)
    union = areas + (box[2:] - box[:2]).clip(0).prod() - inside
    return inside / np.maximum(union, 1e-12)
