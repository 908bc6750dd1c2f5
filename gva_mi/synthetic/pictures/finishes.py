"""Finishes of a room: colours of wood, paint, cloth, books, floors and walls.

One formula makes all of them. A surface has coordinates (u, v) in metres. It is divided into cells,
such as tiles, planks, bricks or the backs of books:

1. ``colour = base(cell) · (1 + vary · h(cell)) · (1 + rough · noise(u, v)) · joint``

``base`` is the other colour in a share of the cells, ``h`` a hash in [-1, 1], and ``joint`` dark
between cells. Colours are linear albedo.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple, dataclass, replace

import drjit as dr
import numpy as np
from drjit import ArrayBase as Array
from numpy.random import Generator

from gva_mi.synthetic.person.identity import Color, linear, palette
from gva_mi.synthetic.person.texture import hash01, value_noise

ENDLESS_CELL = 100.0  # m, side of a cell; chosen: larger than any room
JOINT_SHADE = 0.45  # factor on the colour between cells; chosen by eye


@dataclass(frozen=True)
class Finish:
    """The parameters of one surface."""

    color: Color
    other: Color = (0.5, 0.5, 0.5)
    share: float = 0.0  # of the cells that have the other colour
    cell: tuple[float, float] = (ENDLESS_CELL, ENDLESS_CELL)  # m, along u and v
    shift: float = 0.0  # of each row of cells against the one below, in cells
    joint: float = 0.0  # m, width of the dark lines between cells
    vary: float = 0.0  # variation of the cells' brightness
    grain: tuple[float, float] = (30.0, 30.0)  # 1/m, frequency of the noise along u and v
    rough: float = 0.03  # amplitude of the noise

    def mean_color(self) -> Color:
        """Return the average colour, for indirect light."""
        mix = lambda a, b: float((1 - self.share) * a + self.share * b)
        return tuple(map(mix, self.color, self.other))

    def row(self) -> list[float]:
        """Return the parameters as numbers, one for each of COLUMNS."""
        return np.hstack(astuple(self)).tolist()


COLUMNS = (  # of a row
    "r", "g", "b", "other r", "other g", "other b", "share", "cell u", "cell v", "shift", "joint",
    "vary", "grain u", "grain v", "rough",
)  # fmt: skip


def finish_color(table: Array, number: Array, u: Array, v: Array) -> Array:
    """Return the albedo, an ``Array3f``, at (u, v), metres, of surfaces ``number`` of a table.

    ``table`` holds the rows of all finishes, one after the other.
    """
    import mitsuba as mi

    of = lambda name: dr.gather(mi.Float, table, number * len(COLUMNS) + COLUMNS.index(name))
    salt = mi.Float(number)
    row = dr.floor(v / of("cell v"))
    u_shifted = u + of("shift") * row * of("cell u")
    column = dr.floor(u_shifted / of("cell u"))
    picked = hash01(column, row, salt)
    other, usual = (mi.Color3f(*(of(name + c) for c in "rgb")) for name in ("other ", ""))
    color = dr.select(picked < of("share"), other, usual)
    color *= 1 + of("vary") * (2 * hash01(column, row, salt + 57) - 1)
    x, y = u_shifted - column * of("cell u"), v - row * of("cell v")
    edge = dr.minimum(dr.minimum(x, of("cell u") - x), dr.minimum(y, of("cell v") - y))
    color *= dr.select(edge < 0.5 * of("joint"), JOINT_SHADE, 1.0)
    point = mi.Vector3f(u * of("grain u"), v * of("grain v"), 7 * picked + salt)
    grain = value_noise(point) * 0.6 + value_noise(point * 3.7) * 0.4
    return mi.Color3f(*(dr.clip(c * (1 + of("rough") * grain), 0.0, 0.9) for c in color))


# Palettes in 8-bit sRGB, chosen by eye: common colours.
_WOODS = [linear(*c) for c in ((176, 128, 84), (122, 82, 52), (206, 172, 130), (84, 58, 42))]
_PAINTS = [linear(*c) for c in ((236, 232, 224), (222, 214, 200), (205, 214, 218), (214, 222, 206),
                                (232, 214, 190), (160, 178, 190), (150, 122, 108))]  # fmt: skip
_CARPETS = [linear(*c) for c in ((150, 142, 132), (96, 100, 112), (170, 150, 122), (112, 62, 60),
                                 (70, 84, 78))]  # fmt: skip
_STONES = [linear(*c) for c in ((206, 200, 190), (150, 146, 142), (96, 94, 96), (190, 168, 144))]
_CLOTHS = [linear(*c) for c in ((120, 124, 132), (62, 74, 96), (150, 96, 70), (86, 104, 84),
                                (196, 186, 170), (160, 50, 52))]  # fmt: skip
_BOOKS = [linear(*c) for c in ((150, 48, 44), (44, 70, 110), (206, 190, 150), (52, 88, 66),
                               (220, 160, 60), (40, 40, 46))]  # fmt: skip


def wood(rng: Generator) -> Finish:
    """Draw a wood with its grain along v."""
    return Finish(palette(rng, _WOODS), grain=(70, 4), rough=float(rng.uniform(0.15, 0.35)))


def paint(rng: Generator, like: Sequence[Color] = ()) -> Finish:
    """Draw the paint of a wall; its colour is one of ``like`` now and then."""
    color = palette(rng, like) if len(like) and rng.random() < 0.25 else palette(rng, _PAINTS)
    return Finish(color, grain=(6, 6), rough=float(rng.uniform(0.02, 0.06)))


def cloth(rng: Generator, like: Sequence[Color] = ()) -> Finish:
    """Draw the cloth of a sofa; its colour is one of ``like`` now and then."""
    color = palette(rng, like) if len(like) and rng.random() < 0.3 else palette(rng, _CLOTHS)
    plain = Finish(color, grain=(220, 220), rough=0.18)
    if rng.random() < 0.6:
        return plain
    width = float(rng.uniform(0.02, 0.09))
    return replace(plain, other=palette(rng, _CLOTHS), share=0.45, cell=(width, ENDLESS_CELL))


def books(rng: Generator) -> Finish:
    """Draw the backs of a row of books."""
    first, second = (palette(rng, _BOOKS) for _ in range(2))
    cell = (float(rng.uniform(0.022, 0.04)), ENDLESS_CELL)
    return Finish(first, second, share=0.5, cell=cell, joint=0.004, vary=0.6, rough=0.05)


def poster(rng: Generator) -> Finish:
    """Draw a picture on a wall: patches of two colours."""
    side = float(rng.uniform(0.04, 0.2))
    first, second = palette(rng, _BOOKS), palette(rng, _PAINTS)
    return Finish(
        first, other=second, share=0.5, cell=(side, 1.4 * side), shift=0.5, vary=0.3, grain=(9, 9),
        rough=0.5,
    )  # fmt: skip


def doors(rng: Generator) -> Finish:
    """Draw the front of a cupboard: doors or drawers."""
    cell = (float(rng.uniform(0.35, 0.6)), float(rng.choice([0.25, 0.4, ENDLESS_CELL])))
    whole = wood(rng) if rng.random() < 0.6 else paint(rng)
    return replace(whole, cell=cell, joint=0.008, vary=0.03)


def floor(rng: Generator) -> Finish:
    """Draw a floor: planks, tiles or a carpet."""
    kind = rng.choice(["planks", "tiles", "carpet"])
    if kind == "planks":
        cell = float(rng.uniform(0.07, 0.16)), float(rng.uniform(0.8, 1.6))
        found = replace(wood(rng), cell=cell[::-1], shift=0.37, joint=0.003, vary=0.18)
        return replace(found, grain=(4, 70))
    if kind == "tiles":
        side, shift = float(rng.uniform(0.15, 0.5)), float(rng.choice([0.0, 0.0, 0.5]))
        first, second = (palette(rng, _STONES) for _ in range(2))
        return Finish(
            first, other=second, share=float(rng.choice([0.0, 0.0, 0.5])), cell=(side, side),
            shift=shift, joint=0.006, vary=0.08, grain=(25, 25), rough=0.10,
        )  # fmt: skip
    return Finish(palette(rng, _CARPETS), grain=(160, 160), rough=float(rng.uniform(0.15, 0.4)))


def wall(rng: Generator, like: Sequence[Color] = ()) -> Finish:
    """Draw a wall: painted, with wallpaper, or of bricks."""
    kind = rng.choice(["paint", "paint", "stripes", "paper", "bricks"])
    plain = paint(rng, like)
    if kind == "stripes":
        width = float(rng.uniform(0.05, 0.2))
        return replace(plain, other=paint(rng).color, share=0.5, cell=(width, ENDLESS_CELL))
    if kind == "paper":
        side = float(rng.uniform(0.04, 0.12))
        other = tuple(0.7 * c for c in plain.color)
        return replace(plain, other=other, share=0.35, cell=(side, side), shift=0.5, vary=0.08)
    if kind == "bricks":
        color = linear(*((158, 88, 66) if rng.random() < 0.5 else (214, 206, 196)))
        return Finish(
            color, cell=(0.24, 0.075), shift=0.5, joint=0.011, vary=0.2, grain=(60, 60), rough=0.25
        )
    return plain
