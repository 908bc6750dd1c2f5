"""``KnownPerson``: what is remembered of a person, to recognise them in the next picture."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from gva_mi.body.pose import SIDES
from gva_mi.data.landmarks import BODY
from gva_mi.data.networks.body_landmarks import SeenBody
from gva_mi.data.networks.turned_square import TurnedSquare

_BINS = 4  # of each colour channel
_MEMORY = 0.9  # share of the colours that stays in each picture
_STEADY = 0.7  # likewise of the speed
# Of the radius: what a person hardly moves beyond the expected place from one picture to the next,
# and in each picture without a sight.
_STEP, _DRIFT = 1.0, 0.3
_FORGOTTEN, _ONCE = 60, 5  # pictures after which nobody is expected any more; after one sight
_DOUBTFUL = 0.6  # of the usual likeness of colours: less is another person, if others are near
_AT = 0.4  # of the radius: who is so near is where a person is expected
_NEAR = 1.2  # of the radius: people closer than this hide each other
_SURROUNDINGS = 5.0  # of the radius: side of the square in which a person is searched
_TORSO = [BODY.index(f"{s}_{part}") for part in ("shoulder", "hip") for s in SIDES]


@dataclass
class KnownPerson:
    """A person who was seen before: place, size, speed and the colours of the torso."""

    body: SeenBody  # when last seen
    colours: np.ndarray  # (bins,) of sum 1
    speed: np.ndarray = field(default_factory=lambda: np.zeros(2))  # pixels a picture
    usual: float = 0.7  # likeness of the colours from picture to picture
    unseen: int = 0  # pictures since then
    sights: int = 1

    @property
    def is_expected(self) -> bool:
        """Whether the person may still be around; who was seen once may have been nobody."""
        return self.unseen < min(_FORGOTTEN, _ONCE * self.sights)

    @property
    def expected(self) -> np.ndarray:
        """Where the hips (2,) are now, if the person has gone on, pixels."""
        return self.body.hips + self.unseen * self.speed

    @property
    def surroundings(self) -> TurnedSquare:
        """The part of the picture to search for this person."""
        return TurnedSquare(tuple(self.expected.tolist()), _SURROUNDINGS * self.body.radius)

    def resemblance(self, body: SeenBody, colours: np.ndarray) -> float:
        """Return how much somebody looks like this person: 1 is the expected place and colours."""
        moved = np.linalg.norm(body.hips - self.expected) / self.body.radius
        grown = abs(np.log(body.radius / self.body.radius))
        return _likeness(colours, self.colours) - float(moved + grown) / (
            _STEP + _DRIFT * self.unseen
        )

    def is_doubtful(self, colours: np.ndarray) -> bool:
        """Return whether these colours are hardly this person's."""
        return _likeness(colours, self.colours) < _DOUBTFUL * self.usual

    def is_at(self, body: SeenBody) -> bool:
        """Return whether somebody is where this person is expected."""
        return bool(np.linalg.norm(body.hips - self.expected) < _AT * self.body.radius)

    def is_near(self, other: KnownPerson) -> bool:
        """Return whether this person and another one may hide each other now."""
        apart = np.linalg.norm(self.expected - other.expected)
        return bool(apart < _NEAR * max(self.body.radius, other.body.radius))

    def update(self, body: SeenBody, colours: np.ndarray, hidden: bool) -> None:
        """Remember a new sight; what is half ``hidden`` has others' colours."""
        moved = (body.hips - self.body.hips) / max(1, self.unseen)
        self.body, self.unseen, self.sights = body, 0, self.sights + 1
        if not hidden:
            self.speed = _STEADY * self.speed + (1 - _STEADY) * moved
            alike = _likeness(colours, self.colours)
            self.usual = _MEMORY * self.usual + (1 - _MEMORY) * alike
            self.colours = _MEMORY * self.colours + (1 - _MEMORY) * colours


def torso_colours(image: np.ndarray, body: SeenBody) -> np.ndarray:
    """Return the histogram of colours (64,) of sum 1 between shoulders and hips."""
    corners = body.points[_TORSO]
    limit = np.array(image.shape[1::-1])
    left, top = np.floor(corners.min(0)).astype(int).clip(0, limit - 1)
    right, bottom = np.maximum(
        np.ceil(corners.max(0)).astype(int).clip(0, limit), (left + 1, top + 1)
    )
    step = max(1, (bottom - top) // 32)
    pixels = image[top:bottom:step, left:right:step].reshape(-1, 3) // (256 // _BINS)
    codes = pixels.astype(int) @ (_BINS * _BINS, _BINS, 1)
    return np.bincount(codes, minlength=_BINS**3) / len(codes)


def _likeness(one: np.ndarray, other: np.ndarray) -> float:
    """Return the overlap of two histograms of sum 1."""
    return float(np.minimum(one, other).sum())
