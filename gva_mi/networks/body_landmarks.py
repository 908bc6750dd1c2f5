"""The body's landmarks and silhouette: MediaPipe's BlazePose, in two passes over a picture.

BlazePose sees a square around the person and gives

* 33 landmarks of the body, and 6 more, 2 of which place the next square; each with a visibility;
* a coarse heat map of each landmark, at whose centre the landmark is refined;
* the same landmarks in metres, in axes turned with the square, relative to the middle of the hips;
* the probability that a pixel is of the person.

A second pass sees the square mirrored. The mean of both is better than each of them, and their
standard deviation shows where the network is unsure. If one pass exchanges left and right arms or
legs, or back and front, the mean would lie between both. Then the pass that is closer to the
picture before is used.

The probability has few pixels for a head and hands. So the network sees a closer square, too, in
two passes. Its border cuts the legs, and the network errs there, so its weight w fades to 0. With
P_0 the mean of the passes over the whole person and P_1 of those over the closer square,

1. ``logit P = (logit P_0 + w logit P_1) / (1 + w)``
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gva_mi.body.pose import SIDES, mirrored_name
from gva_mi.networks.mediapipe import TfliteNetwork, sigmoid, weights_file
from gva_mi.networks.turned_square import TurnedSquare
from gva_mi.subject.landmarks import BODY_LANDMARKS

# As in MediaPipe's graph: the square's side over the diameter of the circle around the person;
# cells of the heat map on each side of a landmark that refine it, and the least probability among
# them.
SQUARE_MARGIN = 1.25
_HEAT_MAP_WINDOW, _HEAT_MAP_PEAK = 3, 0.5
# Side of the closer square over that of the person's square, and shares of its side: without weight
# above its lower border, and over which w grows from 0 to 1. Chosen on two rendered videos, by the
# errors of P around face and hands.
CLOSER_SIDE, UNUSED_BELOW, FADING = 0.7, 0.3, 0.15
LARGEST_LOGIT = 7.0  # of P_0 and P_1: no network is more certain. Chosen
_POINT_COUNT = 39  # BlazePose's landmarks, 33 of them BODY_LANDMARKS
_HIPS, _TOP = 33, 34  # the middle of the hips; the top of the circle around the person
_ARM = ("elbow", "wrist", "pinky", "index", "thumb")
_LEG = ("knee", "ankle", "heel", "foot_index")
_BODY_PARTS = [  # each arm, each leg, the trunk
    [BODY_LANDMARKS.index(f"{side}_{name}") for side in sides for name in names]
    for sides, names in (
        (["left"], _ARM), (["right"], _ARM), (["left"], _LEG), (["right"], _LEG),
        (SIDES, ("shoulder", "hip")),
    )
]  # fmt: skip
# Of the radius. Chosen: two passes that place a part farther apart see two different parts.
_PASSES_DISAGREE = 0.1
_TRUNK = _BODY_PARTS[-1]
_MIRRORED_POINTS = np.array([  # the number, in the mirrored picture, of each of the 39 landmarks
    *(BODY_LANDMARKS.index(mirrored_name(name)) for name in BODY_LANDMARKS),
    *range(33, _POINT_COUNT),
])  # fmt: skip


@dataclass(frozen=True)
class SeenBody:
    """What the network finds of a person in a picture: one pass, or the mean of several."""

    points: np.ndarray  # (39, 2) pixels
    visibility: np.ndarray  # (39,) in [0, 1]
    spread: np.ndarray  # (39,) pixels: standard deviation between passes, of the worse axis
    metric: np.ndarray  # (39, 3) metres in the picture's axes, z away from the camera
    presence: float  # probability that the square shows a person
    silhouettes: tuple[tuple[TurnedSquare, np.ndarray], ...]  # probabilities (s, s) of a square
    closer: tuple[TurnedSquare, np.ndarray] | None = None  # a closer square, and P_1 (s, s) in it

    @property
    def radius(self) -> float:
        """Radius of the circle around the whole person, pixels."""
        return float(np.linalg.norm(self.points[_TOP] - self.points[_HIPS]))

    @property
    def hips(self) -> np.ndarray:
        """The middle of the hips (2,), pixels."""
        return self.points[_HIPS]

    @property
    def square(self) -> TurnedSquare:
        """Where to look for the person in the next picture."""
        return TurnedSquare.upright(self.hips, self.points[_TOP], 2 * SQUARE_MARGIN * self.radius)

    def probability(self, shape: tuple[int, int]) -> np.ndarray:
        """Return the probability (H, W) float32 that a pixel of the picture is of the person."""
        maps = [square.put_back(inside, shape) for square, inside in self.silhouettes]
        P = np.mean(maps, axis=0, dtype=np.float32)
        if self.closer is None:
            return P
        square, inside = self.closer
        w = _fading(len(inside))
        both = _logit(P) + square.put_back(w * _logit(inside), shape)
        return sigmoid(both / (1 + square.put_back(w, shape)))


class BodyNetwork:
    """BlazePose."""

    def __init__(self) -> None:
        """Open the network."""
        self._network = TfliteNetwork(weights_file("pose_landmark_full.tflite"))

    def see(self, image: np.ndarray, square: TurnedSquare, mirrored: bool = False) -> SeenBody:
        """See the person in a square of a picture (H, W, 3) 8-bit once."""
        cut = square.cut(image, self._network.size)
        out = self._network(cut[:, ::-1] if mirrored else cut)
        rows = out["Identity"].reshape(_POINT_COUNT, 5).astype(np.float64)
        places = _refined(rows[:, :2] / self._network.size, out["Identity_3"])
        metric = out["Identity_4"].reshape(_POINT_COUNT, 3).astype(np.float64)
        visibility, inside = sigmoid(rows[:, 3]), sigmoid(out["Identity_2"][..., 0])
        if mirrored:
            places = (places * (-1, 1) + (1, 0))[_MIRRORED_POINTS]
            metric = (metric * (-1, 1, 1))[_MIRRORED_POINTS]
            visibility, inside = visibility[_MIRRORED_POINTS], inside[:, ::-1]
        return SeenBody(
            square.to_picture(places), visibility, np.zeros(_POINT_COUNT), square.turn(metric),
            float(out["Identity_1"][0]), ((square, inside),),
        )  # fmt: skip

    def see_mirrored(self, image: np.ndarray, first: SeenBody, before: SeenBody | None) -> SeenBody:
        """Return the mean of a first pass and of a mirrored one; see :func:`mean_of_passes`."""
        return mean_of_passes([first, self.see(image, first.square, mirrored=True)], before)

    def see_closer(self, image: np.ndarray, body: SeenBody) -> SeenBody:
        """Return a body with the silhouette of its closer square, around chest and belly."""
        x, y = body.points[_TRUNK].mean(0).tolist()
        square = TurnedSquare((x, y), CLOSER_SIDE * body.square.side, body.square.angle)
        passes = [self.see(image, square, mirrored) for mirrored in (False, True)]
        inside = np.mean([seen.silhouettes[0][1] for seen in passes], axis=0)
        return replace(body, closer=(square, inside))


def mean_of_passes(seen: Sequence[SeenBody], before: SeenBody | None) -> SeenBody:
    """Return the mean of passes over one picture.

    ``before`` is the body in the picture before; it decides where they contradict.
    """
    points = np.stack([one.points for one in seen])
    metric = np.stack([one.metric for one in seen])
    mean_points, mean_metric = points.mean(0), metric.mean(0)
    for part in _BODY_PARTS if before is not None else ():
        off = np.linalg.norm(points[:, part] - mean_points[part], axis=-1).mean(1)
        if 2 * off.max() > _PASSES_DISAGREE * before.radius:
            moved = np.linalg.norm(points[:, part] - before.points[part], axis=-1).mean(1)
            chosen = int(moved.argmin())
            mean_points[part], mean_metric[part] = points[chosen, part], metric[chosen, part]
    return SeenBody(
        mean_points,
        np.mean([one.visibility for one in seen], axis=0),
        points.std(0, ddof=1).max(-1),
        mean_metric,
        float(np.mean([one.presence for one in seen])),
        tuple(part for one in seen for part in one.silhouettes),
    )


def _refined(places: np.ndarray, heat: np.ndarray) -> np.ndarray:
    """Move places (39, 2) in [0, 1] to the centre of the heat (h, h, 39), logits, around them."""
    size = heat.shape[0]
    cells = np.floor(places * size).astype(int)  # x, y
    steps = np.arange(-_HEAT_MAP_WINDOW, _HEAT_MAP_WINDOW + 1)
    x, y = cells[:, 0, None, None] + steps, cells[:, 1, None, None] + steps[:, None]
    inside = (x >= 0) & (x < size) & (y >= 0) & (y < size)
    of = np.arange(len(places))[:, None, None]
    weight = sigmoid(heat[y.clip(0, size - 1), x.clip(0, size - 1), of]) * inside
    total = weight.sum((1, 2))
    peak = (weight.max((1, 2)) >= _HEAT_MAP_PEAK) & ((cells >= 0) & (cells < size)).all(1)
    total = np.where(peak, total, 1)
    moved = np.stack([(weight * x).sum((1, 2)), (weight * y).sum((1, 2))], axis=1)
    return np.where(peak[:, None], moved / total[:, None] / size, places)


def _logit(probability: np.ndarray) -> np.ndarray:
    least = sigmoid(np.array(-LARGEST_LOGIT, np.float32))
    P = probability.clip(least, 1 - least)
    return np.log(P / (1 - P))


def _fading(size: int) -> np.ndarray:
    """Return w (size, size) of eq. 1."""
    x = (np.arange(size, dtype=np.float32) + 0.5) / size
    across, down = np.minimum(x, 1 - x), np.minimum(x, 1 - UNUSED_BELOW - x)
    return (np.minimum.outer(down, across) / FADING).clip(0, 1)
