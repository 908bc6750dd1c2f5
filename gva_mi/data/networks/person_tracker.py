"""Follow one person through a film, though others may walk past.

In each picture the body network looks where the person was in the picture before. The detector is
asked again when that finds nobody, in every picture while several people are around, and now and
then to learn whether they are. Every person around is remembered by place, size and the colours of
the torso. A person found in a picture is ours only if it resembles ours more than any other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gva_mi.data.landmarks import BODY
from gva_mi.data.networks.body_landmarks import BodyNetwork, SeenBody
from gva_mi.data.networks.person_detector import DetectedPerson, PersonDetector

FOUND = 0.5  # least presence of a person
_EVERY = 10  # pictures between two that are searched for other people
_SCALES = (1.0, 1.7)  # of a detected square: the detector may take a torso for a whole person
_LOOKS = 3  # at a detected person: each look centres the next
_BINS = 4  # of each colour channel
_MEMORY = 0.9  # share of the colours that stays in each picture
_STEP = 0.5  # of the radius: more between two pictures is unlikely
_SAME = 0.5  # of the radius: detections closer than this are one person
_LEAST = -0.5  # least resemblance to the person who was lost
_TORSO = [BODY.index(f"{s}_{part}") for part in ("shoulder", "hip") for s in ("left", "right")]


@dataclass
class KnownPerson:
    """A person who was seen before."""

    body: SeenBody
    colours: np.ndarray  # (bins,) of the torso, of sum 1
    unseen: int = 0  # pictures since then

    def resemblance(self, body: SeenBody, colours: np.ndarray) -> float:
        """Return how much somebody looks like this person: 1 is the same place and colours."""
        moved = np.linalg.norm(body.hips - self.body.hips) / self.body.radius
        grown = abs(np.log(body.radius / self.body.radius))
        alike = float(np.minimum(colours, self.colours).sum())
        return alike - float(moved + grown) / (2 * _STEP * (1 + self.unseen))

    def update(self, body: SeenBody, colours: np.ndarray) -> None:
        """Remember a new sight of this person."""
        self.body, self.unseen = body, 0
        self.colours = _MEMORY * self.colours + (1 - _MEMORY) * colours


class PersonTracker:
    """Finds one person in picture after picture."""

    def __init__(
        self, detector: PersonDetector, network: BodyNetwork, person: int | None = None
    ) -> None:
        """Follow the N-th ``person`` from the left; without it, the largest and most central.

        The person is chosen in the first picture that shows anybody, or N people.
        """
        self._detector, self._network, self._person = detector, network, person
        self._ours: KnownPerson | None = None
        self._others: list[KnownPerson] = []
        self._number = -1
        self.crowded: list[int] = []  # pictures in which several people were seen
        self.lost: list[int] = []  # pictures in which the person was not found

    @property
    def begun(self) -> bool:
        """Whether the person was chosen."""
        return self._ours is not None

    def follow(self, image: np.ndarray) -> SeenBody | None:
        """Return the body in the next picture (H, W, 3) 8-bit; None if it is not found."""
        self._number += 1
        ours = self._ours
        searched = ours is None or ours.unseen or self._others or self._number % _EVERY == 0
        seen = [] if ours is None or ours.unseen else [self._network.see(image, ours.body.square)]
        seen = [body for body in seen if body.presence >= FOUND]
        if searched or not seen:
            seen = self._with_detected(image, seen)
        if len(seen) > 1:
            self.crowded.append(self._number)
        found = self._begin(image, seen) if ours is None else self._assign(image, seen)
        if found is None:
            self.lost.append(self._number)
        return found

    def _with_detected(self, image: np.ndarray, seen: list[SeenBody]) -> list[SeenBody]:
        """Add the people that the detector finds and that are not among the seen."""
        for person in self._detector.find(image):
            body = self._look(image, person)
            if body is not None and not any(_same(body, other) for other in seen):
                seen = [*seen, body]
        return seen

    def _look(self, image: np.ndarray, person: DetectedPerson) -> SeenBody | None:
        """Return the body of a detected person, if the body network agrees that it is one."""
        bodies = []
        for scale in _SCALES:
            square = person.square.scaled(scale)
            for _ in range(_LOOKS):
                body = self._network.see(image, square)
                square = body.square
            bodies.append(body)
        best = max(bodies, key=lambda body: body.presence * body.visibility.mean())
        return best if best.presence >= FOUND else None

    def _begin(self, image: np.ndarray, seen: Sequence[SeenBody]) -> SeenBody | None:
        """Choose the person, if enough people are there."""
        if len(seen) < (self._person or 1):
            return None
        if self._person is not None:
            chosen = sorted(seen, key=lambda body: body.hips[0])[self._person - 1]
        else:
            middle = np.array(image.shape[1::-1]) / 2
            off = lambda body: float(np.linalg.norm((body.hips - middle) / middle))
            chosen = max(seen, key=lambda body: body.radius / (1 + off(body)))
        self._ours = KnownPerson(chosen, torso_colours(image, chosen))
        rest = [body for body in seen if body is not chosen]
        self._others = [KnownPerson(body, torso_colours(image, body)) for body in rest]
        return chosen

    def _assign(self, image: np.ndarray, seen: Sequence[SeenBody]) -> SeenBody | None:
        """Say who is who; return our person."""
        ours, found = self._ours, None
        colours = [torso_colours(image, body) for body in seen]
        known = [ours, *self._others]
        for person in known:
            person.unseen += 1
        score = np.array([[p.resemblance(*it) for it in zip(seen, colours, strict=True)]
                          for p in known]).reshape(len(known), len(seen))  # fmt: skip
        free = set(range(len(seen)))
        while score.size and score.max() > _LEAST:  # the best pair first
            p, b = np.unravel_index(score.argmax(), score.shape)
            score[p], score[:, b] = -np.inf, -np.inf
            known[p].update(seen[b], colours[b])
            free.remove(b)
            found = seen[b] if p == 0 else found
        self._others += [KnownPerson(seen[b], colours[b]) for b in sorted(free)]
        self._others = [p for p in self._others if p.unseen < 10 * _EVERY]
        return found


def _same(one: SeenBody, other: SeenBody) -> bool:
    return bool(np.linalg.norm(one.hips - other.hips) < _SAME * min(one.radius, other.radius))


def torso_colours(image: np.ndarray, body: SeenBody) -> np.ndarray:
    """Return the histogram of colours (64,) of sum 1 between shoulders and hips."""
    corners = body.points[_TORSO]
    low, high = np.floor(corners.min(0)).astype(int), np.ceil(corners.max(0)).astype(int)
    limit = np.array(image.shape[1::-1])
    low = low.clip(0, limit - 1)
    right, bottom = np.maximum(high.clip(0, limit), low + 1)
    step = max(1, (bottom - low[1]) // 32)
    pixels = image[low[1] : bottom : step, low[0] : right : step].reshape(-1, 3) // (256 // _BINS)
    codes = pixels.astype(int) @ (_BINS * _BINS, _BINS, 1)
    return np.bincount(codes, minlength=_BINS**3) / len(codes)
