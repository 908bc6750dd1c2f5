"""Follow one person through a film, though others may walk past.

In each picture the body network looks where the person was in the picture before. The detector
searches the rest of the picture when that finds nobody, in every picture while several people are
around, and now and then to learn whether they are. A person found in a picture is ours only if it
resembles ours more than any other that is known.

The detector sees the most prominent people: those who are known are painted over. It misses people
who fill less than a fifth of what it sees, so it looks at parts of the picture too: where people
were expected, and at squares over all of it while our person is missing. What it takes for a person
where none was expected is one if the body network agrees twice, of the picture and of its mirror
image.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from gva_mi.data.networks.body_landmarks import BodyNetwork, SeenBody
from gva_mi.data.networks.known_person import KnownPerson, torso_colours
from gva_mi.data.networks.person_detector import PersonDetector, squares_over
from gva_mi.data.networks.turned_square import TurnedSquare

FOUND = 0.5  # least presence of a person
MOST = 6  # people of a picture
_EVERY = 5  # pictures between two that are searched for other people
_SCALES = (1.0, 1.7)  # of a detected square: the detector may take a torso for a whole person
_LOOKS = 3  # at a detected person: each look centres the next
_SAME = 0.4  # of the radius: bodies closer than this are one person
_TRIED = 3  # detected people whom the body network is asked about, of those not known
_AGREE = 0.12  # of the radius: median distance of landmarks in both passes over a person
_GREY = 128
_AROUND = 0.1  # of the radius: painted over around the landmarks
_CLEAR = 0.3  # difference of resemblance that tells two people apart
_LEAST = -0.5  # least resemblance to a known person


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
        seen = []
        if ours is not None and not ours.unseen:
            body = self._network.see(image, ours.body.square)
            seen = [body] if body.presence >= FOUND else []
        if not seen or self._others or self._number % _EVERY == 0:
            seen = self._search(image, seen)
        if len(seen) > 1:
            self.crowded.append(self._number)
        found = self._begin(image, seen) if ours is None else self._assign(image, seen)
        if found is None:
            self.lost.append(self._number)
        return found

    @property
    def _known(self) -> list[KnownPerson]:
        """Our person, once it was chosen, and the others."""
        return self._others if self._ours is None else [self._ours, *self._others]

    def _search(self, image: np.ndarray, seen: list[SeenBody]) -> list[SeenBody]:
        """Add the people who are not among the seen."""
        ours, known, due = self._ours, self._known, self._number % _EVERY == 0
        squares = squares_over(image, max(image.shape[:2]))
        squares += [person.surroundings for person in known if person.unseen or not seen]
        just_lost = ours is not None and ours.unseen < _EVERY
        if not seen and (just_lost or due) and len(set(image.shape[:2])) > 1:
            squares += squares_over(image, min(image.shape[:2]))
        found = self._found_in(squares, image, seen)
        if ours is None and not found and due:
            found = self._found_in(squares_over(image, min(image.shape[:2]) / 2), image, [])
        return found

    def _found_in(
        self, squares: Sequence[TurnedSquare], image: np.ndarray, seen: list[SeenBody]
    ) -> list[SeenBody]:
        """Return the seen, and the other people in squares of a picture."""
        rest = image.copy()
        for body in seen:
            _paint_over(rest, body)
        while len(seen) < MOST:
            looks = map(partial(self._look, rest), self._detector.find(rest, squares)[:_TRIED])
            others = (x for x in looks if x is not None and not any(_is_same(x, y) for y in seen))
            body = next(others, None)
            if body is None:
                break
            seen = [*seen, body]
            _paint_over(rest, body)
        return seen

    def _look(self, image: np.ndarray, person: TurnedSquare) -> SeenBody | None:
        """Return the body of a detected person, if the body network agrees that it is one."""
        bodies = []
        for scale in _SCALES:
            square = person.scaled(scale)
            for _ in range(_LOOKS):
                body = self._network.see(image, square)
                square = body.square
            bodies.append(body)
        best = max(bodies, key=lambda body: body.presence * body.visibility.mean())
        if best.presence < FOUND:
            return None
        if any(person.is_at(best) for person in self._known):
            return best
        mirrored = self._network.see(image, best.square, mirrored=True)
        off = np.median(np.linalg.norm(mirrored.points - best.points, axis=1)) / best.radius
        return best if mirrored.presence >= FOUND and off < _AGREE else None

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
        known = [KnownPerson(body, torso_colours(image, body)) for body in seen]
        self._ours = next(person for person in known if person.body is chosen)
        self._others = [person for person in known if person is not self._ours]
        return chosen

    def _assign(self, image: np.ndarray, seen: Sequence[SeenBody]) -> SeenBody | None:
        """Say who is who; return our person."""
        colours = [torso_colours(image, body) for body in seen]
        known = self._known
        for person in known:
            person.unseen += 1
        score = np.full((len(known), len(seen)), -np.inf)
        for p, person in enumerate(known):
            hidden = any(person.is_near(other) for other in known if other is not person)
            for b, body in enumerate(seen):
                if not (hidden and person.is_doubtful(colours[b])):
                    score[p, b] = person.resemblance(body, colours[b])
        found, free = None, set(range(len(seen)))
        for b in range(len(seen)):
            if _is_ambiguous(score, b):
                score[:, b] = -np.inf
                free.remove(b)
        while score.size and score.max() > _LEAST:  # the best pair first
            p, b = np.unravel_index(score.argmax(), score.shape)
            hidden = any(known[p].is_near(other) for other in known if other is not known[p])
            known[p].update(seen[b], colours[b], hidden)
            score[p], score[:, b] = -np.inf, -np.inf
            free.remove(b)
            found = seen[b] if p == 0 else found
        self._others += [KnownPerson(seen[b], colours[b]) for b in sorted(free)]
        self._others = [person for person in self._others if person.is_expected]
        return found


def _is_ambiguous(score: np.ndarray, b: int) -> bool:
    """Return whether a body may be either of two known people, of whom the other is not seen.

    ``score`` is (known people, seen bodies). It happens while one person hides another.
    """
    order = np.argsort(-score[:, b], kind="stable")
    if len(order) < 2 or score[order[1], b] < max(_LEAST, score[order[0], b] - _CLEAR):
        return False
    elsewhere = np.delete(score[order[:2]], b, axis=1)
    return not elsewhere.size or elsewhere.max() < _LEAST


def _is_same(one: SeenBody, other: SeenBody) -> bool:
    """Return whether two bodies are those of one person."""
    apart = np.linalg.norm(one.hips - other.hips)
    return bool(apart < _SAME * min(one.radius, other.radius))


def _paint_over(image: np.ndarray, body: SeenBody) -> None:
    """Hide a person of a picture (H, W, 3)."""
    margin = _AROUND * body.radius
    left, top = np.floor(body.points.min(0) - margin).astype(int).clip(0)
    right, bottom = np.ceil(body.points.max(0) + margin).astype(int).clip(0)
    image[top:bottom, left:right] = _GREY
