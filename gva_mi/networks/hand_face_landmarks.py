"""The landmarks of hands and face: MediaPipe's networks on squares that the body's landmarks place.

Each network sees an upright square around a hand or a face, and gives points in the square and the
probability that it is one. The square follows from the picture before, or from the body. A second
pass sees the square mirrored, and the mean of both is used.

* A hand has 21 landmarks, also in metres. It is left or right by the wrist that it is near,
  because the network itself often mistakes the side.
* A face has 468 points of a mesh. Only the 51 of :data:`gva_mi.subject.landmarks.FACE_LANDMARKS`
  are kept, which other programs know by their numbers. A face that is turned away, hidden or small
  is not found.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from gva_mi.body.pose import SIDES
from gva_mi.networks.body_landmarks import SeenBody
from gva_mi.networks.mediapipe import TfliteNetwork, sigmoid, weights_file
from gva_mi.networks.turned_square import TurnedSquare
from gva_mi.subject.landmarks import BODY_LANDMARKS, hand_names

_NEW_PART_LOOKS = 2  # passes over a new part. Chosen: the first one centres the second


@dataclass(frozen=True)
class SeenPart:
    """A hand or a face of P points in a picture."""

    points: np.ndarray  # (P, 2) pixels
    spread: np.ndarray  # (P,) pixels: standard deviation between passes, of the worse axis
    metric: np.ndarray  # (P, 3) metres in the picture's axes, z away from the camera; NaN: unknown
    presence: float  # in [0, 1]: that it is one
    square: TurnedSquare  # where to look for it again


See = Callable[..., SeenPart | None]  # of a square, and whether it is seen mirrored


def found_again(
    see: See,
    before: SeenPart | None,
    square: TurnedSquare,
    belongs: Callable[[SeenPart], bool] = lambda part: True,
) -> SeenPart | None:
    """Find a part where it was in the picture before; otherwise in a new square."""
    part = None if before is None else see(before.square)
    if part is not None and belongs(part):
        return part
    for _ in range(_NEW_PART_LOOKS):
        part = see(square)
        if part is None:
            return None
        square = part.square
    return part if belongs(part) else None


def with_mirrored(see: See, first: SeenPart) -> SeenPart:
    """Return the mean of a first pass and a mirrored one; the first if the second finds nothing."""
    second = see(first.square, mirrored=True)
    if second is None:
        return first
    points = np.stack([first.points, second.points])
    return SeenPart(
        points.mean(0), points.std(0, ddof=1).max(-1), (first.metric + second.metric) / 2,
        (first.presence + second.presence) / 2, first.square,
    )  # fmt: skip


LEAST_HAND_PRESENCE = 0.3  # probability of a hand. Chosen: the wrist confirms it, too
_HAND_POINTS = 21  # landmarks of a hand
_WRIST, _MIDDLE = 0, 9  # the wrist, the root of the middle finger
_PALM = tuple(k for k, name in enumerate(hand_names("left")) if not name.endswith(("dip", "tip")))
# As in MediaPipe's graph: side of the next square over the palm's extent, and its shift toward the
# fingers. The first square, from the body's landmarks, has this side over the hand's length.
_PALM_MARGIN, _FINGERWARD_SHIFT = 2.0, 0.1
_HAND_MARGIN = 2.0
# Of the diameter of the circle around the person. Both chosen by eye.
_WRIST_DISTANCE = 0.15  # a hand farther from its wrist is another hand, or no hand
_LEAST_HAND_LENGTH = 0.08  # of a hand that points at the camera


class HandNetwork:
    """MediaPipe's hand network."""

    def __init__(self) -> None:
        """Open the network."""
        self._network = TfliteNetwork(weights_file("hand_landmark_full.tflite"))

    def find(
        self, image: np.ndarray, body: SeenBody, before: dict[str, SeenPart]
    ) -> dict[str, SeenPart]:
        """Return the hands that are found in a picture (H, W, 3) 8-bit, by side.

        Args:
            image: the picture.
            body: the body in it.
            before: the hands in the picture before.
        """
        hands, reach = {}, _WRIST_DISTANCE * 2 * body.radius
        see = partial(self._see, image)
        for side in SIDES:
            near_wrist = lambda hand, side=side: _from_wrist(hand, body, side) < reach
            hand = found_again(see, before.get(side), _square_at_wrist(body, side), near_wrist)
            if hand is not None:
                hand = with_mirrored(see, hand)
                hands[side] = replace(hand, square=_square_around_hand(hand.points))
        return _one_each(hands, body)

    def _see(
        self, image: np.ndarray, square: TurnedSquare, mirrored: bool = False
    ) -> SeenPart | None:
        """See the hand in a square once; None if there is none."""
        cut = square.cut(image, self._network.size)
        out = self._network(cut[:, ::-1] if mirrored else cut)
        if (presence := float(out["Identity_1"][0])) < LEAST_HAND_PRESENCE:
            return None
        places = out["Identity"].reshape(_HAND_POINTS, 3)[:, :2] / self._network.size
        metric = out["Identity_3"].reshape(_HAND_POINTS, 3).astype(np.float64)
        if mirrored:
            places, metric = places * (-1, 1) + (1, 0), metric * (-1, 1, 1)
        points = square.to_picture(places)
        zero = np.zeros(_HAND_POINTS)
        return SeenPart(points, zero, square.turn(metric), presence, _square_around_hand(points))


def _square_around_hand(points: np.ndarray) -> TurnedSquare:
    """Return where to look for a hand with these points (21, 2) again."""
    roots = np.average(points[[5, 9, 13]], axis=0, weights=(1, 2, 1))
    turned = TurnedSquare.upright(roots, 2 * roots - points[_WRIST], 1.0)
    palm = turned.from_picture(points[list(_PALM)])
    low, high = palm.min(0), palm.max(0)
    extent = high - low
    centre = (low + high) / 2 - (0, _FINGERWARD_SHIFT * extent[1])
    x, y = turned.to_picture(centre).tolist()
    return TurnedSquare((x, y), _PALM_MARGIN * float(extent.max()), turned.angle)


def _square_at_wrist(body: SeenBody, side: str) -> TurnedSquare:
    """Return where the body's own landmarks place a hand."""
    wrist, index, pinky = (_at(body, f"{side}_{part}") for part in ("wrist", "index", "pinky"))
    middle = (2 * index + pinky) / 3
    length = max(2 * float(np.linalg.norm(middle - wrist)), _LEAST_HAND_LENGTH * 2 * body.radius)
    up = (middle - wrist) / max(float(np.linalg.norm(middle - wrist)), 1e-6)
    centre = middle + _FINGERWARD_SHIFT * length * up
    return TurnedSquare.upright(centre, centre + up, _HAND_MARGIN * length)


def _from_wrist(hand: SeenPart, body: SeenBody, side: str) -> float:
    """Return how far the hand's wrist is from the body's, pixels."""
    return float(np.linalg.norm(hand.points[_WRIST] - _at(body, f"{side}_wrist")))


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


LEAST_FACE_PRESENCE = 0.5  # probability of a face. Chosen, as MediaPipe's default
SMALLEST_FACE_SQUARE = 32.0  # pixels, side. Chosen: in a smaller one no face can be recognised
_MESH_POINTS = (  # the network's numbers of the points 17 to 67
    70, 63, 105, 66, 107, 336, 296, 334, 293, 300,  # brows, the right one's outer end first
    168, 6, 195, 4, 98, 97, 2, 326, 327,  # nose: down its bridge, then below, from right to left
    33, 160, 158, 133, 153, 144, 362, 385, 387, 263, 373, 380,  # right eye, left eye
    61, 39, 37, 0, 267, 269, 291, 405, 314, 17, 84, 181,  # lips, around their outer border
    78, 82, 13, 312, 308, 317, 14, 87,  # around the inner one
)  # fmt: skip
_MIRRORED_FACE = (  # the number, in the mirrored picture, of each of the 51 points
    9, 8, 7, 6, 5, 4, 3, 2, 1, 0, 10, 11, 12, 13, 18, 17, 16, 15, 14,
    28, 27, 26, 25, 30, 29, 22, 21, 20, 19, 24, 23,
    37, 36, 35, 34, 33, 32, 31, 42, 41, 40, 39, 38, 47, 46, 45, 44, 43, 50, 49, 48,
)  # fmt: skip
_MESH_EYES = (33, 263)  # outer corners of the eyes in the mesh: right, left
_MESH_MARGIN = 1.5  # side of the next square over the mesh's extent, as in MediaPipe's graph
# Side of the first square over the distance from eyes to mouth, and between the ears. Chosen: the
# larger one holds for a face from the front and from the side.
_FACE_PER_EYES_TO_MOUTH, _FACE_PER_EARS = 3.6, 1.9
# Of the diameter of the circle around the person. Chosen: a face farther from the body's eyes and
# mouth is somebody else's.
_FACE_DISTANCE = 0.06


class FaceNetwork:
    """MediaPipe's face mesh."""

    def __init__(self) -> None:
        """Open the network."""
        self._network = TfliteNetwork(weights_file("face_landmark.tflite"))

    def find(self, image: np.ndarray, body: SeenBody, before: SeenPart | None) -> SeenPart | None:
        """Return the face of a body in a picture (H, W, 3) 8-bit, if the network sees it.

        Args:
            image: the picture.
            body: the body in it.
            before: the face in the picture before.
        """
        see = partial(self._see, image, body)
        face = found_again(see, before, _square_of_body(body))
        return None if face is None else with_mirrored(see, face)

    def _see(
        self, image: np.ndarray, body: SeenBody, square: TurnedSquare, mirrored: bool = False
    ) -> SeenPart | None:
        """See the face in a square once; None if there is none, or if it is somebody else's."""
        if square.side < SMALLEST_FACE_SQUARE:
            return None
        cut = square.cut(image, self._network.size)
        out = self._network(cut[:, ::-1] if mirrored else cut).values()
        (mesh,) = (x.reshape(-1, 3) for x in out if x.size > 1)
        (logit,) = (x.ravel()[0] for x in out if x.size == 1)
        places = mesh[:, :2].astype(np.float64) / self._network.size
        if mirrored:
            places = places * (-1, 1) + (1, 0)
        mesh, presence = square.to_picture(places), float(sigmoid(logit))
        points = mesh[list(_MESH_POINTS)]
        if mirrored:
            points = points[list(_MIRRORED_FACE)]
        far = np.linalg.norm(points.mean(0) - _middle_of(body)) > _FACE_DISTANCE * 2 * body.radius
        if presence < LEAST_FACE_PRESENCE or far:
            return None
        n = len(points)
        metric = np.full((n, 3), np.nan)
        return SeenPart(points, np.zeros(n), metric, presence, _square_around_face(mesh))


def _square_around_face(mesh: np.ndarray) -> TurnedSquare:
    """Return the square around a mesh (468, 2) in which its eyes are level."""
    along = mesh[_MESH_EYES[1]] - mesh[_MESH_EYES[0]]
    up = np.array([along[1], -along[0]])
    level = TurnedSquare.upright(mesh.mean(0), mesh.mean(0) + up, 1.0)
    places = level.from_picture(mesh)
    low, high = places.min(0), places.max(0)
    x, y = level.to_picture((low + high) / 2).tolist()
    return TurnedSquare((x, y), _MESH_MARGIN * float((high - low).max()), level.angle)


def _at(body: SeenBody, *names: str) -> np.ndarray:
    """Return the mean of the given landmarks of a body (2,)."""
    return body.points[[BODY_LANDMARKS.index(name) for name in names]].mean(0)


def _middle_of(body: SeenBody) -> np.ndarray:
    """Return the middle of eyes and mouth (2,)."""
    return (_at(body, "left_eye", "right_eye") + _at(body, "mouth_left", "mouth_right")) / 2


def _square_of_body(body: SeenBody) -> TurnedSquare:
    """Return where the body's own landmarks place the face."""
    up = _at(body, "left_eye", "right_eye") - _at(body, "mouth_left", "mouth_right")
    wide = _at(body, "left_ear") - _at(body, "right_ear")
    tall, broad = _FACE_PER_EYES_TO_MOUTH, _FACE_PER_EARS
    side = max(tall * float(np.linalg.norm(up)), broad * float(np.linalg.norm(wide)))
    middle = _middle_of(body)
    return TurnedSquare.upright(middle, middle + up, side)
