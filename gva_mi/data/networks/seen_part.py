"""``SeenPart``: a hand or a face in a picture, and how it is looked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from gva_mi.data.networks.turned_square import TurnedSquare

_LOOKS = 2  # at a part that is found anew: each look centres the next


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
    """Look where a part was in the picture before; if it is not there, in a new square."""
    part = None if before is None else see(before.square)
    if part is not None and belongs(part):
        return part
    for _ in range(_LOOKS):
        part = see(square)
        if part is None:
            return None
        square = part.square
    return part if belongs(part) else None


def with_mirrored(see: See, first: SeenPart) -> SeenPart:
    """Return the mean of a first pass and of a mirrored one, if that sees the part as well."""
    second = see(first.square, mirrored=True)
    if second is None:
        return first
    points = np.stack([first.points, second.points])
    return SeenPart(
        points.mean(0), points.std(0, ddof=1).max(-1), (first.metric + second.metric) / 2,
        (first.presence + second.presence) / 2, first.square,
    )  # fmt: skip
