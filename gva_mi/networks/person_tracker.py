"""Find people in a picture, and follow one of them through a video.

MediaPipe's pose detector gives for each of 2254 anchors a score and, relative to the anchor, a box
around the head and four points. Two of these count: the middle of the hips, and the top of a circle
around the whole person, whose centre is the middle of the hips.

In each picture the body network looks where the person was in the picture before. The detector
searches the whole picture in three cases: if the body network finds nobody; in every picture for a
while after several people were seen; and at intervals, to learn whether there are several. It finds
the most prominent people, so known people are painted over. It misses people who fill less than a
fifth of its input, so parts of the picture are searched, too. A detection counts if the body
network confirms it twice: on the picture and on its mirror image.

Of several people, the tracker follows the one near the expected place, of the same size, and with
the same colours between shoulders and hips. It remembers the others, too: a body that resembles one
of them more is not the person. While the person is hidden, it returns nobody.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from gva_mi.body.pose import SIDES
from gva_mi.networks.body_landmarks import SQUARE_MARGIN, BodyNetwork, SeenBody
from gva_mi.networks.mediapipe import TfliteNetwork, sigmoid, weights_file
from gva_mi.networks.turned_square import TurnedSquare
from gva_mi.subject.landmarks import BODY_LANDMARKS

# As in MediaPipe's graph of the detector.
LEAST_DETECTION_SCORE = 0.5
_SAME_BOX_IOU = 0.3  # detections whose boxes overlap by more are one person
_ANCHOR_GRIDS = ((8, 2), (16, 2), (32, 6))  # stride of a grid, pixels; anchors in each cell

# All chosen by eye. Lengths are relative to the radius of the circle around the person.
LEAST_PRESENCE = 0.5  # probability, by the body network, that a square shows a person
PEOPLE_LIMIT = 6  # people that are searched for in a picture, which bounds the time
_SEARCH_EVERY = 5  # pictures: in every fifth one others are searched for
_CROWDED_PICTURES = 60  # pictures after others were seen, in each of which others are searched for
_DETECTION_SCALES = (1.0, 1.7)  # of a detected square: the detector may take a torso for a person
_DETECTION_LOOKS = 3  # passes over a detected person, each of which centres the next
_SAME_PERSON_DISTANCE = 0.4  # bodies whose hips are closer are one person
_DETECTIONS_TRIED = 3  # unknown detections that the body network is run on, the best first
_PASSES_AGREE = 0.12  # median distance of the landmarks in both passes over a person
_PAINT = 128  # 8-bit grey that hides known people from the detector
_PAINT_MARGIN = 0.1  # around the landmarks
_LOST_SQUARE = 5.0  # side of the square in which a lost person is searched for

# How the followed person is recognised among others; all chosen by eye.
_COLOR_BINS = 4  # of each channel, in the histogram of the torso
_COLOR_MEMORY, _SPEED_MEMORY = 0.9, 0.7  # shares of old colours and speed kept in each picture
_FREE_STEP = 1.0  # distance from the expected place that costs as much as other colours
_FREE_GROWTH = 0.5  # logarithm of a change of the size that does
_FREE_DRIFT = 0.3  # growth of both with each picture in which the person was not seen
_LEAST_RESEMBLANCE = -0.5  # overlap of the colours less the cost of the distance
_LEAST_COLOR_OVERLAP = 0.42  # if others are around; with less it is another person
_TORSO = [BODY_LANDMARKS.index(f"{s}_{part}") for part in ("shoulder", "hip") for s in SIDES]


class PersonDetector:
    """MediaPipe's pose detector."""

    def __init__(self) -> None:
        """Open the network."""
        self._network = TfliteNetwork(weights_file("pose_detection.tflite"))
        self._anchors = _anchors(self._network.size)  # (2254, 2) in [0, 1]

    def find(self, image: np.ndarray, squares: Sequence[TurnedSquare]) -> list[TurnedSquare]:
        """Return a square for the landmark network around each person in a picture (H, W, 3) 8-bit.

        Only ``squares`` of the picture are searched. People who fill less than a fifth of a square
        are missed. The most certain person comes first.
        """
        seen = zip(*(self._see(image, square) for square in squares), strict=True)
        scores, boxes, points = map(np.concatenate, seen)
        order = np.argsort(-scores, kind="stable")
        order = order[scores[order] >= LEAST_DETECTION_SCORE]
        people = []
        while len(order):  # the mean of overlapping boxes, weighted by their scores, is a person
            same = _overlap(boxes[order[0]], boxes[order]) > _SAME_BOX_IOU
            same[0] = True
            group, order = order[same], order[~same]
            hips, top = np.average(points[group], axis=0, weights=scores[group])
            radius = float(np.linalg.norm(top - hips))
            people.append(TurnedSquare.upright(hips, top, 2 * SQUARE_MARGIN * radius))
        return people

    def _see(self, image: np.ndarray, square: TurnedSquare) -> tuple[np.ndarray, ...]:
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
    rows, columns = (_middles(length, side) for length in image.shape[:2])
    return [TurnedSquare((x, y), side) for y in rows for x in columns]


def _middles(length: int, side: float) -> list[float]:
    """Return the middles of intervals of length ``side`` that cover ``length``.

    Neighbours overlap by half or more. One interval is enough if it is longer than ``length``.
    """
    if side >= length:
        return [length / 2]
    count = math.ceil(2 * (length - side) / side) + 1
    return np.linspace(side / 2, length - side / 2, count).tolist()


def _anchors(size: int) -> np.ndarray:
    """Return the centres of the anchors (n, 2) in [0, 1], in the network's order."""
    grids = []
    for stride, each in _ANCHOR_GRIDS:
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


class _Track:
    """One of the people of a video, as last seen."""

    def __init__(self, body: SeenBody, colours: np.ndarray) -> None:
        self.body = body
        self.colours = colours  # of the torso, of sum 1
        self._speed = np.zeros(2)  # pixels a picture
        self.unseen = 0  # pictures since then

    @property
    def expected(self) -> np.ndarray:
        """Where the hips (2,) are now, if the person has gone on, pixels."""
        return self.body.hips + self.unseen * self._speed

    def likeness(self, colours: np.ndarray) -> float:
        """Return how much of the colours is the person's, in [0, 1]."""
        return float(np.minimum(self.colours, colours).sum())

    def resemblance(self, body: SeenBody, colours: np.ndarray) -> float:
        """Return how much a body resembles the person: by its colours, place and size."""
        moved = np.linalg.norm(body.hips - self.expected) / self.body.radius
        grown = abs(np.log(body.radius / self.body.radius))
        cost = float(moved / _FREE_STEP + grown / _FREE_GROWTH)
        return self.likeness(colours) - cost / (1 + _FREE_DRIFT * self.unseen)

    def go_on(self, body: SeenBody, colours: np.ndarray) -> None:
        """Take over the person's body in this picture."""
        moved = (body.hips - self.body.hips) / self.unseen
        self._speed = _SPEED_MEMORY * self._speed + (1 - _SPEED_MEMORY) * moved
        self.colours = _COLOR_MEMORY * self.colours + (1 - _COLOR_MEMORY) * colours
        self.body, self.unseen = body, 0


class PersonTracker:
    """Finds one person in picture after picture."""

    def __init__(self, detector: PersonDetector, network: BodyNetwork, person: int | None) -> None:
        """Follow the N-th ``person`` from the left; without it, the largest and most central.

        The person is chosen in the first picture that shows anybody, or N people.
        """
        self._detector, self._network, self._number_from_left = detector, network, person
        self._people: list[_Track] = []  # the followed person first
        self._picture = -1
        self.crowded: list[int] = []  # pictures in which several people were seen
        self.lost: list[int] = []  # pictures in which the person was not found

    @property
    def begun(self) -> bool:
        """Whether the person was chosen."""
        return bool(self._people)

    @property
    def _several(self) -> bool:
        """Whether several people were seen lately."""
        return bool(self.crowded) and self._picture - self.crowded[-1] < _CROWDED_PICTURES

    def follow(self, image: np.ndarray) -> SeenBody | None:
        """Return the body in the next picture (H, W, 3) 8-bit; None if it is not found."""
        self._picture += 1
        seen = []
        if self.begun and not self._people[0].unseen:
            body = self._network.see(image, self._people[0].body.square)
            seen = [body] if body.presence >= LEAST_PRESENCE else []
        if not seen or self._several or self._picture % _SEARCH_EVERY == 0:
            seen = self._search(image, seen)
        if len(seen) > 1:
            self.crowded.append(self._picture)
        tracks = [_Track(body, torso_colours(image, body)) for body in seen]
        found = self._recognise(tracks) if self.begun else self._choose(image, tracks)
        if found is None:
            self.lost.append(self._picture)
        return found

    def _search(self, image: np.ndarray, seen: list[SeenBody]) -> list[SeenBody]:
        """Return the seen people, and others whom the detector finds."""
        due = self._picture % _SEARCH_EVERY == 0
        squares, just_lost = squares_over(image, max(image.shape[:2])), False
        if self.begun and not seen:
            person = self._people[0]
            side, just_lost = _LOST_SQUARE * person.body.radius, person.unseen < _SEARCH_EVERY
            squares.append(TurnedSquare(tuple(person.expected.tolist()), side))
        if not seen and (just_lost or due) and len(set(image.shape[:2])) > 1:
            squares += squares_over(image, min(image.shape[:2]))
        found = self._found_in(squares, image, seen)
        if not self.begun and not found and due:
            found = self._found_in(squares_over(image, min(image.shape[:2]) / 2), image, [])
        return found

    def _found_in(
        self, squares: Sequence[TurnedSquare], image: np.ndarray, seen: list[SeenBody]
    ) -> list[SeenBody]:
        """Return the seen people, and the other people in squares of a picture."""
        rest = image.copy()
        for body in seen:
            _paint_over(rest, body)
        while len(seen) < PEOPLE_LIMIT:
            detected = self._detector.find(rest, squares)[:_DETECTIONS_TRIED]
            looks = (self._look(rest, square) for square in detected)
            others = (x for x in looks if x is not None and not any(_is_same(x, y) for y in seen))
            body = next(others, None)
            if body is None:
                break
            seen = [*seen, body]
            _paint_over(rest, body)
        return seen

    def _look(self, image: np.ndarray, person: TurnedSquare) -> SeenBody | None:
        """Return the body of a detected person, if the body network confirms the detection."""
        bodies = []
        for scale in _DETECTION_SCALES:
            square = person.scaled(scale)
            for _ in range(_DETECTION_LOOKS):
                body = self._network.see(image, square)
                square = body.square
            bodies.append(body)
        best = max(bodies, key=lambda body: body.presence * body.visibility.mean())
        if best.presence < LEAST_PRESENCE:
            return None
        if self.begun:
            person = self._people[0]
            off = np.linalg.norm(best.hips - person.expected) / person.body.radius
            if off < _SAME_PERSON_DISTANCE:
                return best
        mirrored = self._network.see(image, best.square, mirrored=True)
        off = np.median(np.linalg.norm(mirrored.points - best.points, axis=1)) / best.radius
        return best if mirrored.presence >= LEAST_PRESENCE and off < _PASSES_AGREE else None

    def _choose(self, image: np.ndarray, seen: list[_Track]) -> SeenBody | None:
        """Choose the person to follow; None if too few people are seen."""
        if len(seen) < (self._number_from_left or 1):
            return None
        if self._number_from_left is not None:
            from_left = sorted(seen, key=lambda track: track.body.hips[0])
            chosen = from_left[self._number_from_left - 1]
        else:
            middle = np.array(image.shape[1::-1]) / 2
            off = lambda body: float(np.linalg.norm((body.hips - middle) / middle))
            chosen = max(seen, key=lambda track: track.body.radius / (1 + off(track.body)))
        self._people = [chosen, *(track for track in seen if track is not chosen)]
        return chosen.body

    def _recognise(self, seen: list[_Track]) -> SeenBody | None:
        """Find the people in this picture; return the body of the followed one, None if hidden.

        ``seen`` are its bodies. Of all bodies and people, those that resemble each other most are
        paired first.
        """
        for track in self._people:
            track.unseen += 1
        pairs = [
            (known.resemblance(new.body, new.colours), known, new)
            for known in self._people
            for new in seen
            if not self._foreign(known, new)
        ]
        for resemblance, known, new in sorted(pairs, key=lambda pair: -pair[0]):
            if resemblance > _LEAST_RESEMBLANCE and known.unseen and new in seen:
                known.go_on(new.body, new.colours)
                seen = [track for track in seen if track is not new]
        person, *others = self._people
        others = [track for track in others if track.unseen < _CROWDED_PICTURES]
        self._people = [person, *others, *seen]
        return None if person.unseen else person.body

    def _foreign(self, known: _Track, new: _Track) -> bool:
        """Return whether others are around, and a body lacks the followed person's colours."""
        followed = known is self._people[0] and self._several
        return followed and known.likeness(new.colours) < _LEAST_COLOR_OVERLAP


def torso_colours(image: np.ndarray, body: SeenBody) -> np.ndarray:
    """Return the histogram of colours (64,) of sum 1 between shoulders and hips."""
    corners = body.points[_TORSO]
    limit = np.array(image.shape[1::-1])
    left, top = np.floor(corners.min(0)).astype(int).clip(0, limit - 1)
    end = np.ceil(corners.max(0)).astype(int).clip(0, limit)
    right, bottom = np.maximum(end, (left + 1, top + 1))
    step = max(1, (bottom - top) // 32)
    pixels = image[top:bottom:step, left:right:step].reshape(-1, 3) // (256 // _COLOR_BINS)
    codes = pixels.astype(int) @ (_COLOR_BINS * _COLOR_BINS, _COLOR_BINS, 1)
    return np.bincount(codes, minlength=_COLOR_BINS**3) / len(codes)


def _is_same(one: SeenBody, other: SeenBody) -> bool:
    """Return whether two bodies belong to one person."""
    apart = np.linalg.norm(one.hips - other.hips)
    return bool(apart < _SAME_PERSON_DISTANCE * min(one.radius, other.radius))


def _paint_over(image: np.ndarray, body: SeenBody) -> None:
    """Hide a person of a picture (H, W, 3)."""
    margin = _PAINT_MARGIN * body.radius
    left, top = np.floor(body.points.min(0) - margin).astype(int).clip(0)
    right, bottom = np.ceil(body.points.max(0) + margin).astype(int).clip(0)
    image[top:bottom, left:right] = _PAINT
