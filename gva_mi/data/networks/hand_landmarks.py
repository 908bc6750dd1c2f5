"""The landmarks of both hands: MediaPipe's hand network, on squares at the body's wrists.

The network sees a square around a hand, fingers up, and gives 21 landmarks in the square and in
metres, and the probability that it sees a hand. Where to look comes from the same hand in the
picture before, or from the body's wrist, index and little finger. A hand is left or right by the
wrist that it hangs on, because the network itself often mistakes the side.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gva_mi.data.landmarks import BODY, hand_names
from gva_mi.data.networks.body_landmarks import SeenBody
from gva_mi.data.networks.tflite import TfliteNetwork
from gva_mi.data.networks.turned_square import TurnedSquare
from gva_mi.data.networks.weights import weights_file

SIDES = ("left", "right")
FOUND = 0.3  # least probability of a hand
_POINTS = 21
_WRIST, _MIDDLE = 0, 9  # the wrist, the root of the middle finger
_PALM = tuple(k for k, name in enumerate(hand_names("left")) if not name.endswith(("dip", "tip")))
_AROUND_PALM = 2.0  # side of the next square, relative to the palm's extent
_AROUND_WRIST = 2.0  # likewise of a square from the body, relative to the hand's length
_FORWARD = 0.1  # shift of both towards the fingers
_LOOKS = 2  # at a hand that is found anew: each look centres the next
_FAR = 0.15  # of the person's circle's diameter: a hand farther from its wrist is another thing


@dataclass(frozen=True)
class SeenHand:
    """A hand in a picture."""

    points: np.ndarray  # (21, 2) pixels
    spread: np.ndarray  # (21,) pixels: standard deviation between passes, of the worse axis
    metric: np.ndarray  # (21, 3) metres in the picture's axes, z away from the camera
    presence: float  # in [0, 1]: that it is a hand

    @property
    def square(self) -> TurnedSquare:
        """Where to look for the hand again."""
        roots = np.average(self.points[[5, 9, 13]], axis=0, weights=(1, 2, 1))
        turned = TurnedSquare.upright(roots, 2 * roots - self.points[_WRIST], 1.0)
        palm = turned.from_picture(self.points[list(_PALM)])
        low, high = palm.min(0), palm.max(0)
        extent = high - low
        centre = (low + high) / 2 - (0, _FORWARD * extent[1])
        x, y = turned.to_picture(centre).tolist()
        return TurnedSquare((x, y), _AROUND_PALM * float(extent.max()), turned.angle)


class HandNetwork:
    """MediaPipe's hand network."""

    def __init__(self, folder: Path | None = None) -> None:
        """Open the network; ``folder`` holds the weights."""
        self._network = TfliteNetwork(weights_file("hand_landmark_full.tflite", folder))

    def find(
        self, image: np.ndarray, body: SeenBody, before: dict[str, SeenHand], passes: int
    ) -> dict[str, SeenHand]:
        """Return the hands that are found in a picture (H, W, 3) 8-bit, by side.

        Args:
            image: the picture.
            body: the body in it.
            before: the hands in the picture before.
            passes: 1, or 2 with a mirrored one.
        """
        found = {}
        for side in SIDES:
            hand = self._look(image, body, side, before.get(side))
            if hand is not None:
                found[side] = self._see_again(image, hand) if passes > 1 else hand
        return _one_each(found, body)

    def _look(
        self, image: np.ndarray, body: SeenBody, side: str, before: SeenHand | None
    ) -> SeenHand | None:
        """Look where the hand was; if it is not there, at the body's wrist."""
        if before is not None:
            hand = self._see(image, before.square)
            if hand.presence >= FOUND and _hangs_on(hand, body, side):
                return hand
        square = _square_at_wrist(body, side)
        for _ in range(_LOOKS):
            hand = self._see(image, square)
            if hand.presence < FOUND:
                return None
            square = hand.square
        return hand if _hangs_on(hand, body, side) else None

    def _see(self, image: np.ndarray, square: TurnedSquare, mirrored: bool = False) -> SeenHand:
        """See the hand in a square once."""
        cut = square.cut(image, self._network.size)
        out = self._network(cut[:, ::-1] if mirrored else cut)
        places = out["Identity"].reshape(_POINTS, 3)[:, :2] / self._network.size
        metric = out["Identity_3"].reshape(_POINTS, 3).astype(np.float64)
        if mirrored:
            places, metric = places * (-1, 1) + (1, 0), metric * (-1, 1, 1)
        presence = float(out["Identity_1"][0])
        return SeenHand(square.to_picture(places), np.zeros(_POINTS), square.turn(metric), presence)

    def _see_again(self, image: np.ndarray, first: SeenHand) -> SeenHand:
        """Return the mean of a first pass and of a mirrored one, if that sees a hand as well."""
        second = self._see(image, first.square, mirrored=True)
        if second.presence < FOUND:
            return first
        points = np.stack([first.points, second.points])
        return SeenHand(
            points.mean(0),
            points.std(0, ddof=1).max(-1),
            (first.metric + second.metric) / 2,
            (first.presence + second.presence) / 2,
        )


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


def _from_wrist(hand: SeenHand, body: SeenBody, side: str) -> float:
    """Return how far the hand's wrist is from the body's, pixels."""
    return float(np.linalg.norm(hand.points[_WRIST] - _body_point(body, side, "wrist")))


def _hangs_on(hand: SeenHand, body: SeenBody, side: str) -> bool:
    return _from_wrist(hand, body, side) < _FAR * 2 * body.radius


def _one_each(found: dict[str, SeenHand], body: SeenBody) -> dict[str, SeenHand]:
    """Drop the hand that is farther from its wrist if both were found in one place."""
    if len(found) == 2:
        left, right = (found[side] for side in SIDES)
        apart = np.linalg.norm(left.points - right.points, axis=-1).mean()
        size = np.linalg.norm(left.points[_MIDDLE] - left.points[_WRIST])
        if apart < size / 2:
            far = max(SIDES, key=lambda side: _from_wrist(found[side], body, side))
            return {side: hand for side, hand in found.items() if side != far}
    return found
