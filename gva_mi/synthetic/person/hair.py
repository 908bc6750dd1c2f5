"""Hair: a closed surface around the head.

It is a cap on the skull, and for longer cuts a volume around it:

    f = smax( smin( d - thickness, volume ), -face, d - rise )

d is the distance from the body, ``face`` that from the opening of the face (negative inside), and
``rise`` the largest distance of hair from the skin. It grows away from the hairline, so that hair
begins there instead of framing the face like a hood. Long hair falls behind the shoulders over the
shirt. Locks vary the thickness around the head.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from gva_mi.synthetic.person.bodies import RestBody
from gva_mi.synthetic.person.identity import Outfit
from gva_mi.synthetic.person.level_sets import (
    BodySurface,
    RestMesh,
    VoxelGrid,
    smax,
    smin,
    smoothstep,
    surface_of,
)

# In metres, chosen by eye on a head of usual size.
HAIR_CELL = 0.005  # grid of hair; chosen: resolves locks
LONG_HAIR_THICKNESS = 0.014  # on the back, over the cloth below it
HAIRLINE_THICKNESS = 0.007  # largest thickness of hair above the skin, at the hairline
HAIRLINE_GROWTH = 1.1  # metres of this thickness, per metre from the hairline
EAR_RADIUS = 0.034  # around an ear that short hair leaves free


@dataclass(frozen=True)
class _Head:
    """The measures of a head, metres."""

    eyes: np.ndarray  # (3,) between the eyes
    neck: np.ndarray  # (3,) the joint
    middle: np.ndarray  # (3,) of the skull
    half: np.ndarray  # (3,) half of the skull's size
    top: float  # height of the crown
    unit: float  # size relative to the head that this file's numbers were made for

    @staticmethod
    def of(rest: RestBody) -> _Head:
        """Measure the head of a body."""
        eyes, points = rest.between_eyes, rest.surface.points
        skull = points[points[:, 1] > eyes[1] - 0.02]
        top = skull[:, 1].max()
        half = np.ptp(skull, axis=0) / 2
        middle = (skull.max(0) + skull.min(0)) / 2
        return _Head(eyes, rest.joints["neck"], middle, half, top, (top - eyes[1]) / 0.115)

    @property
    def jaw(self) -> float:
        return self.eyes[1] - 0.105 * self.unit

    def ends(self, style: str) -> float:
        """Return the height at which hair of a style ends."""
        if style == "short":
            return self.eyes[1] - 0.08 * self.unit
        return self.jaw - 0.005 * self.unit if style == "bob" else self.neck[1] - 0.12

    def grid(self, ends: float) -> VoxelGrid:
        """Return a grid around the head, down to where the hair ends."""
        reach = np.array([self.half[0] + 0.09, 0, self.half[2] + 0.10])
        low, high = self.middle - reach, self.middle + reach
        low[1], high[1] = ends - 0.03, self.top + 0.06
        return VoxelGrid.around(low, high, HAIR_CELL)


@dataclass(frozen=True)
class _Locks:
    """Coordinates around a head and how its hair varies there; all broadcast to the grid."""

    x: np.ndarray  # metres, from the middle of the skull
    y: np.ndarray  # metres, height in the rest pose
    z: np.ndarray  # metres, from the middle of the skull
    fall: np.ndarray  # 0 on the crown, 1 at the ends
    below: np.ndarray  # metres below the eyes, 0 above them
    locks: np.ndarray  # in [-1, 1], thickness around the head

    @staticmethod
    def draw(head: _Head, grid: VoxelGrid, rng: Generator) -> _Locks:
        x, y, z = grid.x - head.middle[0], grid.y, grid.z - head.middle[2]
        angle = np.arctan2(z, x)
        locks = sum(
            np.cos(n * angle + rng.uniform(0, 2 * np.pi) + rng.uniform(-15, 15) * y) / 3
            for n in (9, 14, 23)
        )
        fall = smoothstep(head.top - y, 0.02, 0.25)
        return _Locks(x, y, z, fall, np.maximum(head.eyes[1] - y, 0), locks)


def hair_mesh(rest: RestBody, outfit: Outfit, rng: Generator, shirt: BodySurface) -> RestMesh:
    """Model the hair of a head: "short" follows the skull, a "bob" hangs to the jaw, "long" hair
    falls over the ``shirt`` to the shoulder blades. ``rng`` draws locks and parting.
    """
    head, style, thick = _Head.of(rest), outfit.hair, outfit.hair_thick
    ends = head.ends(style)
    grid = head.grid(ends)
    d = rest.surface.sample(grid)
    at = _Locks.draw(head, grid, rng)
    x, y, z = at.x, at.y, at.z
    parting = np.exp(-(((x - rng.choice([-1, 1]) * 0.028) / 0.012) ** 2))
    parting = parting * (z > -0.3 * head.half[2])
    uncut = d - thick * (1 + 0.25 * at.locks * (0.4 + at.fall))
    uncut = uncut + 0.004 * parting * (y > head.eyes[1] + 0.06)
    face = _face_opening(head, at)
    if style == "short":
        # A slanting line from the temples over the ears to the nape.
        line = head.eyes[1] + 0.015 * head.unit + np.where(z > 0, 0.15, 0.75) * z
        field = smax(uncut, line - y, 0.015)
        field = smax(field, ends - y)
        field = smax(field, -_around_ears(rest.surface, grid, head), 0.012)
    else:
        if style == "bob":  # hangs to the jaw and is drawn in toward it
            volume = _ellipsoid(head, thick, at, 0.034 * head.unit, 0.12 * at.below, 0.0)
        else:
            volume = _long(head, thick, at, shirt.sample(grid))
        uncut = smin(smax(uncut, head.jaw - y), volume, 0.02)
        field = smax(uncut, ends + 0.006 * at.locks - y, 0.015)
    rise = HAIRLINE_THICKNESS + HAIRLINE_GROWTH * np.maximum(face, 0) + 0.8 * at.below
    field = smax(field, d - rise, 0.01)
    return surface_of(grid, smax(field, -face, 0.012), None if style == "short" else uncut)


def _face_opening(head: _Head, at: _Locks) -> np.ndarray:
    """Return the distance from an ellipse in front, open downward to free cheeks and chin."""
    width, brow = 0.062 * head.unit, head.eyes[1] + 0.055 * head.unit
    centre = head.eyes[1] - 0.03 * head.unit
    up = np.where(at.y > centre, (at.y - centre) / (brow - centre), 0.0)
    face = (np.sqrt((at.x / width) ** 2 + up**2) - 1) * width
    return smax(face, 0.10 * head.half[2] - at.z, 0.02)


def _long(head: _Head, thick: float, at: _Locks, shirt: np.ndarray) -> np.ndarray:
    """Return the volume of hair behind the shoulders; ``shirt`` is the distance from the shirt."""
    y = at.y
    tuck = 0.25 * np.maximum(at.below - 0.06, 0)
    volume = _ellipsoid(head, thick, at, 0.026 * head.unit, tuck, 0.12)
    # Only behind the shoulders, and narrower than they are.
    front = 0.06 * smoothstep(y, head.neck[1], head.jaw)
    front = front + np.where(y > head.jaw, 10 * (y - head.jaw), 0)
    behind = at.z - front + 0.35 * head.half[2]
    volume = smax(volume, behind, 0.03)
    lies = shirt - LONG_HAIR_THICKNESS * (1 + 0.3 * at.locks)
    return smin(volume, smax(lies, smax(volume - 0.03, behind), 0.02), 0.02)


def _ellipsoid(
    head: _Head, thick: float, at: _Locks, stand: float, tuck: np.ndarray, lean: float
) -> np.ndarray:
    """Return half an ellipsoid above the eyes that continues downward as a tube.

    It stands ``stand`` metres off the skull at the height of the eyes, further down ``tuck`` metres
    less, and falls back by ``lean`` per metre below the eyes.
    """
    half_x = head.half[0] + stand - tuck
    half_z = head.half[2] + np.where(at.z > 0, 0.45, 1.0) * stand - 0.3 * tuck
    back = at.z + lean * at.below
    wave = 1 + 0.022 * at.locks * at.fall
    over = np.maximum(at.y - head.eyes[1], 0) / (head.top + thick - head.eyes[1])
    volume = np.sqrt((at.x / half_x) ** 2 + (back / half_z) ** 2 + over**2) / wave
    return (volume - 1) * np.minimum(half_x, half_z)


def _around_ears(surface: BodySurface, grid: VoxelGrid, head: _Head) -> np.ndarray:
    """Return the distance from a ball around each ear, the head's widest point at eye height."""
    level = np.abs(surface.points[:, 1] - head.eyes[1]) < 0.03
    side = surface.points[level & (surface.points[:, 2] < head.eyes[2] - 0.03)]
    ear = side[np.argsort(-np.abs(side[:, 0] - head.middle[0]))[:20]].mean(0)
    across = np.abs(side[:, 0] - head.middle[0]).max()
    x = np.abs(grid.x - head.middle[0]) - across
    return np.sqrt(x**2 + (grid.y - ear[1]) ** 2 + (grid.z - ear[2]) ** 2) - EAR_RADIUS
