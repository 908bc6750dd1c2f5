"""The landmarks of both hands: MediaPipe's hand network, on squares at the body's wrists.

The network sees a square around a hand, fingers up, and gives 21 landmarks in the square and in
metres, and the probability that it sees a hand. Where to look comes from the same hand in the
picture before, or from the body's wrist, index and little finger. A hand is left or right by the
wrist that it hangs on, because the network itself often mistakes the side.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from gva_mi.body.pose import SIDES
from gva_mi.data.landmarks import BODY, hand_names
from gva_mi.data.networks.body_landmarks import SeenBody
from gva_mi.data.networks.seen_part import SeenPart, found_again, with_mirrored
from gva_mi.data.networks.tflite import TfliteNetwork
from gva_mi.data.networks.turned_square import TurnedSquare
from gva_mi.data.networks.weights import weights_file

FOUND = 0.3  # least probability of a hand
_POINTS = 21
_WRIST, _MIDDLE = 0, 9  # the wrist, the root of the middle finger
_PALM = tuple(k for k, name in enumerate(hand_names("left")) if not name.endswith(("dip", "tip")))
_AROUND_PALM = 2.0  # side of the next square, relative to the palm's extent
_AROUND_WRIST = 2.0  # likewise of a square from the body, relative to the hand's length
_FORWARD = 0.1  # shift of both towards the fingers
_FAR = 0.15  # of the person's circle's diameter: a hand farther from its wrist is another thing


class HandNetwork:
    """MediaPipe's hand network."""

    def __init__(self, folder: Path | None = None) -> None:
        """Open the network; ``folder`` holds the weights."""
        self._network = TfliteNetwork(weights_file("hand_landmark_full.tflite", folder))

    def find(
        self, image: np.ndarray, body: SeenBody, before: dict[str, SeenPart]
    ) -> dict[str, SeenPart]:
        """Return the hands that are found in a picture (H, W, 3) 8-bit, by side.

        Args:
            image: the picture.
            body: the body in it.
            before: the hands in the picture before.
        """
        found = {}
        see = partial(self._see, image)
        for side in SIDES:
            hangs_on = lambda hand, side=side: (
                _from_wrist(hand, body, side) < _FAR * 2 * body.radius
            )
            hand = found_again(see, before.get(side), _square_at_wrist(body, side), hangs_on)
            if hand is not None:
                hand = with_mirrored(see, hand)
                found[side] = replace(hand, square=_square_around(hand.points))
        return _one_each(found, body)

    def _see(
        self, image: np.ndarray, square: TurnedSquare, mirrored: bool = False
    ) -> SeenPart | None:
        """See the hand in a square once; None if there is none."""
        cut = square.cut(image, self._network.size)
        out = self._network(cut[:, ::-1] if mirrored else cut)
        if (presence := float(out["Identity_1"][0])) < FOUND:
            return None
        places = out["Identity"].reshape(_POINTS, 3)[:, :2] / self._network.size
        metric = out["Identity_3"].reshape(_POINTS, 3).astype(np.float64)
        if mirrored:
            places, metric = places * (-1, 1) + (1, 0), metric * (-1, 1, 1)
        points = square.to_picture(places)
        zero = np.zeros(_POINTS)
        return SeenPart(points, zero, square.turn(metric), presence, _square_around(points))


def _square_around(points: np.ndarray) -> TurnedSquare:
    """Return where to look for a hand with these points (21, 2) again."""
    roots = np.average(points[[5, 9, 13]], axis=0, weights=(1, 2, 1))
    turned = TurnedSquare.upright(roots, 2 * roots - points[_WRIST], 1.0)
    palm = turned.from_picture(points[list(_PALM)])
    low, high = palm.min(0), palm.max(0)
    extent = high - low
    centre = (low + high) / 2 - (0, _FORWARD * extent[1])
    x, y = turned.to_picture(centre).tolist()
    return TurnedSquare((x, y), _AROUND_PALM * float(extent.max()), turned.angle)


def _body_point(body: SeenBody, side: str, part: str) -> np.ndarray:
    return body.points[BODY.index(f"{side}_{part}")]


def _square_at_wrist(body: SeenBody, side: str) -> TurnedSquare:
    """Return where the body's own landmarks place a hand."""
    wrist, index, pinky = (_body_point(body, side, part) for part in ("wrist", "index", "pinky"))
    middle = (2 * index + pinky) / 3
    length = max(2 * float(np.linalg.norm(middle - wrist)), 0.08 * 2 * body.radius)
    up = (middle - wrist) / max(float(np.linalg.norm(middle - wrist)), 1e-6)
    centre = middle + _FORWARD * length * up
    return TurnedSquare.upright(centre, centre + up, _AROUND_WRIST * length)


def _from_wrist(hand: SeenPart, body: SeenBody, side: str) -> float:
    """Return how far the hand's wrist is from the body's, pixels."""
    return float(np.linalg.norm(hand.points[_WRIST] - _body_point(body, side, "wrist")))


def _one_each(found: dict[str, SeenPart], body: SeenBody) -> dict[str, SeenPart]:
    """Drop the hand that is farther from its wrist if both were found in one place."""
    if len(found) == 2:
        left, right = (found[side] for side in SIDES)
        apart = np.linalg.norm(left.points - right.points, axis=-1).mean()
        size = np.linalg.norm(left.points[_MIDDLE] - left.points[_WRIST])
        if apart < size / 2:
            far = max(SIDES, key=lambda side: _from_wrist(found[side], body, side))
            return {side: hand for side, hand in found.items() if side != far}
    return found
