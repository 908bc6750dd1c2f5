"""The landmarks of the face: MediaPipe's face mesh, on a square around the body's eyes and mouth.

The network sees a square around a face, upright, and gives 468 points of a mesh on it and the
probability that it sees a face. Those 51 are kept that other programs know by their numbers
(:data:`gva_mi.data.landmarks.FACE`). Where to look comes from the picture before, or from the
body's landmarks. A face that is turned away, hidden or small is not found.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import numpy as np

from gva_mi.data.landmarks import BODY
from gva_mi.data.networks.body_landmarks import SeenBody
from gva_mi.data.networks.seen_part import SeenPart, found_again, with_mirrored
from gva_mi.data.networks.tflite import TfliteNetwork, sigmoid
from gva_mi.data.networks.turned_square import TurnedSquare
from gva_mi.data.networks.weights import weights_file

FOUND = 0.5  # least probability of a face
SMALLEST = 32.0  # pixels: the side of a square in which a face can be read
_MESH = (  # of the network's 468 points, those with the numbers 17 to 67
    70, 63, 105, 66, 107, 336, 296, 334, 293, 300,  # brows, the right one's outer end first
    168, 6, 195, 4, 98, 97, 2, 326, 327,  # nose: down its bridge, then below, from right to left
    33, 160, 158, 133, 153, 144, 362, 385, 387, 263, 373, 380,  # right eye, left eye
    61, 39, 37, 0, 267, 269, 291, 405, 314, 17, 84, 181,  # lips, around their outer border
    78, 82, 13, 312, 308, 317, 14, 87,  # around the inner one
)  # fmt: skip
_MIRRORED = (  # which of the 51 each of them is in a mirrored picture
    9, 8, 7, 6, 5, 4, 3, 2, 1, 0, 10, 11, 12, 13, 18, 17, 16, 15, 14,
    28, 27, 26, 25, 30, 29, 22, 21, 20, 19, 24, 23,
    37, 36, 35, 34, 33, 32, 31, 42, 41, 40, 39, 38, 47, 46, 45, 44, 43, 50, 49, 48,
)  # fmt: skip
_EYES = (33, 263)  # outer corners in the mesh: right, left
_AROUND_MESH = 1.5  # side of the next square, relative to the mesh's extent
_AROUND_BODY = 3.6, 1.9  # of a first square: times the eyes' distance to the mouth, and the ears'
_FAR = 0.06  # of the person's circle's diameter: a face farther from the body's is another one


class FaceNetwork:
    """MediaPipe's face mesh."""

    def __init__(self, folder: Path | None = None) -> None:
        """Open the network; ``folder`` holds the weights."""
        self._network = TfliteNetwork(weights_file("face_landmark.tflite", folder))

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
        """See the face in a square once; None if there is none, or that of somebody else."""
        if square.side < SMALLEST:
            return None
        cut = square.cut(image, self._network.size)
        out = self._network(cut[:, ::-1] if mirrored else cut).values()
        (mesh,) = (x.reshape(-1, 3) for x in out if x.size > 1)
        (logit,) = (x.ravel()[0] for x in out if x.size == 1)
        places = mesh[:, :2].astype(np.float64) / self._network.size
        if mirrored:
            places = places * (-1, 1) + (1, 0)
        mesh, presence = square.to_picture(places), float(sigmoid(logit))
        points = mesh[list(_MESH)]
        if mirrored:
            points = points[list(_MIRRORED)]
        far = np.linalg.norm(points.mean(0) - _middle_of(body)) > _FAR * 2 * body.radius
        if presence < FOUND or far:
            return None
        n = len(points)
        metric = np.full((n, 3), np.nan)
        return SeenPart(points, np.zeros(n), metric, presence, _square_around(mesh))


def _square_around(mesh: np.ndarray) -> TurnedSquare:
    """Return the square around a mesh (468, 2) in which its eyes are level."""
    along = mesh[_EYES[1]] - mesh[_EYES[0]]
    up = np.array([along[1], -along[0]])
    level = TurnedSquare.upright(mesh.mean(0), mesh.mean(0) + up, 1.0)
    places = level.from_picture(mesh)
    low, high = places.min(0), places.max(0)
    x, y = level.to_picture((low + high) / 2).tolist()
    return TurnedSquare((x, y), _AROUND_MESH * float((high - low).max()), level.angle)


def _at(body: SeenBody, *names: str) -> np.ndarray:
    """Return the middle of some landmarks of a body (2,)."""
    return body.points[[BODY.index(name) for name in names]].mean(0)


def _middle_of(body: SeenBody) -> np.ndarray:
    """Return the middle of eyes and mouth (2,)."""
    return (_at(body, "left_eye", "right_eye") + _at(body, "mouth_left", "mouth_right")) / 2


def _square_of_body(body: SeenBody) -> TurnedSquare:
    """Return where the body's own landmarks place the face."""
    up = _at(body, "left_eye", "right_eye") - _at(body, "mouth_left", "mouth_right")
    wide = _at(body, "left_ear") - _at(body, "right_ear")
    tall, broad = _AROUND_BODY
    side = max(tall * float(np.linalg.norm(up)), broad * float(np.linalg.norm(wide)))
    middle = _middle_of(body)
    return TurnedSquare.upright(middle, middle + up, side)
