"""What a room is made of: colours of floors, walls and furniture, and pieces of furniture.

**Colours.** One formula, whose parameters make all of them. A surface has coordinates (u, v) in
metres. It is divided into cells, such as tiles, planks, bricks or the backs of books:

1. ``colour = base(cell) · (1 + vary · h(cell)) · (1 + rough · noise(u, v)) · joint``

``base`` is the other colour in a share of the cells, ``h`` a hash in [-1, 1], and ``joint`` dark
between cells. Colours are linear albedo.

**Pieces** are made of boxes and, for plants, of leaves. A piece stands against a wall: x runs along
it, y up, z away from it, metres. Each corner of a triangle has its own vertex, with coordinates
(u, v) of its finish. Triangles have no outside: light meets the side that is seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import drjit as dr
import numpy as np
from drjit import ArrayBase as Array

from gva_mi.synthetic.people import Color, linear, palette
from gva_mi.synthetic.texture import hash01, value_noise

ENDLESS = 100.0  # m, side of a cell that is larger than any room
DARK = 0.45  # factor of a joint


@dataclass(frozen=True)
class Finish:
    """The parameters of one surface."""

    color: Color
    other: Color = (0.5, 0.5, 0.5)
    share: float = 0.0  # of the cells that have the other colour
    cell: tuple[float, float] = (ENDLESS, ENDLESS)  # m, along u and v
    shift: float = 0.0  # of each row of cells against the one below, in cells
    joint: float = 0.0  # m, width of the dark lines between cells
    vary: float = 0.0  # variation of the cells' brightness
    grain: tuple[float, float] = (30.0, 30.0)  # 1/m, frequency of the noise along u and v
    rough: float = 0.03  # amplitude of the noise

    def mean_color(self) -> Color:
        """Return the average colour, for indirect light."""
        return tuple(
            float((1 - self.share) * a + self.share * b)
            for a, b in zip(self.color, self.other, strict=True)
        )

    def row(self) -> list[float]:
        """Return the parameters as numbers, in the order that :func:`finish_color` reads."""
        return [
            *self.color, *self.other, self.share, *self.cell, self.shift, self.joint, self.vary,
            *self.grain, self.rough,
        ]  # fmt: skip


WIDTH = len(Finish((0, 0, 0)).row())


def finish_color(table: Array, number: Array, u: Array, v: Array) -> Array:
    """Return the albedo, an ``Array3f``, at (u, v), metres, of surfaces ``number`` of a table.

    ``table`` holds the rows of all finishes, one after the other.
    """
    import mitsuba as mi

    of = lambda k: dr.gather(mi.Float, table, number * WIDTH + k)
    salt = mi.Float(number)
    row = dr.floor(v / of(8))
    u_shifted = u + of(9) * row * of(7)
    column = dr.floor(u_shifted / of(7))
    picked = hash01(column, row, salt)
    color = dr.select(
        picked < of(6), mi.Color3f(of(3), of(4), of(5)), mi.Color3f(of(0), of(1), of(2))
    )
    color *= 1 + of(11) * (2 * hash01(column, row, salt + 57) - 1)
    x, y = u_shifted - column * of(7), v - row * of(8)
    edge = dr.minimum(dr.minimum(x, of(7) - x), dr.minimum(y, of(8) - y))
    color *= dr.select(edge < 0.5 * of(10), DARK, 1.0)
    point = mi.Vector3f(u * of(12), v * of(13), 7 * picked + salt)
    grain = value_noise(point) * 0.6 + value_noise(point * 3.7) * 0.4
    return mi.Color3f(*(dr.clip(c * (1 + of(14) * grain), 0.0, 0.9) for c in color))


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


def wood(rng: np.random.Generator) -> Finish:
    """Draw a wood with its grain along v."""
    return Finish(palette(rng, _WOODS), grain=(70, 4), rough=float(rng.uniform(0.15, 0.35)))


def paint(rng: np.random.Generator, like: Sequence[Color] = ()) -> Finish:
    """Draw the paint of a wall; its colour is one of ``like`` now and then."""
    color = palette(rng, like) if len(like) and rng.random() < 0.25 else palette(rng, _PAINTS)
    return Finish(color, grain=(6, 6), rough=float(rng.uniform(0.02, 0.06)))


def cloth(rng: np.random.Generator, like: Sequence[Color] = ()) -> Finish:
    """Draw the cloth of a sofa; its colour is one of ``like`` now and then."""
    color = palette(rng, like) if len(like) and rng.random() < 0.3 else palette(rng, _CLOTHS)
    plain = Finish(color, grain=(220, 220), rough=0.18)
    if rng.random() < 0.6:
        return plain
    width = float(rng.uniform(0.02, 0.09))
    return replace(plain, other=palette(rng, _CLOTHS), share=0.45, cell=(width, ENDLESS))


def books(rng: np.random.Generator) -> Finish:
    """Draw the backs of a row of books."""
    first, second = (palette(rng, _BOOKS) for _ in range(2))
    width = float(rng.uniform(0.022, 0.04))
    return Finish(first, second, 0.5, (width, ENDLESS), joint=0.004, vary=0.6, rough=0.05)


def poster(rng: np.random.Generator) -> Finish:
    """Draw a picture on a wall: patches of two colours."""
    side = float(rng.uniform(0.04, 0.2))
    first, second = palette(rng, _BOOKS), palette(rng, _PAINTS)
    return Finish(first, second, 0.5, (side, 1.4 * side), 0.5, vary=0.3, grain=(9, 9), rough=0.5)


def doors(rng: np.random.Generator) -> Finish:
    """Draw the front of a cupboard: doors or drawers."""
    cell = (float(rng.uniform(0.35, 0.6)), float(rng.choice([0.25, 0.4, ENDLESS])))
    whole = wood(rng) if rng.random() < 0.6 else paint(rng)
    return replace(whole, cell=cell, joint=0.008, vary=0.03)


def floor(rng: np.random.Generator) -> Finish:
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
            first, second, float(rng.choice([0.0, 0.0, 0.5])), (side, side), shift, 0.006, 0.08,
            (25, 25), 0.10,
        )  # fmt: skip
    return Finish(palette(rng, _CARPETS), grain=(160, 160), rough=float(rng.uniform(0.15, 0.4)))


def wall(rng: np.random.Generator, like: Sequence[Color] = ()) -> Finish:
    """Draw a wall: painted, with wallpaper, or of bricks."""
    kind = rng.choice(["paint", "paint", "stripes", "paper", "bricks"])
    plain = paint(rng, like)
    if kind == "stripes":
        width = float(rng.uniform(0.05, 0.2))
        return replace(plain, other=paint(rng).color, share=0.5, cell=(width, ENDLESS))
    if kind == "paper":
        side = float(rng.uniform(0.04, 0.12))
        other = tuple(0.7 * c for c in plain.color)
        return replace(plain, other=other, share=0.35, cell=(side, side), shift=0.5, vary=0.08)
    if kind == "bricks":
        color = linear(*((158, 88, 66) if rng.random() < 0.5 else (214, 206, 196)))
        return Finish(color, (0, 0, 0), 0.0, (0.24, 0.075), 0.5, 0.011, 0.2, (60, 60), 0.25)
    return plain


@dataclass(frozen=True)
class Solid:
    """A mesh of one finish."""

    vertices: np.ndarray  # (N, 3) metres
    uv: np.ndarray  # (N, 2) metres
    faces: np.ndarray  # (F, 3)
    finish: Finish


def box(low: Sequence[float], high: Sequence[float], finish: Finish) -> Solid:
    """Return the box between two corners."""
    corners = np.array([low, high], dtype=np.float64)
    vertices, uv = [], []
    for right, up in ((2, 1), (0, 2), (0, 1)):
        for side in (0, 1):
            for a, b in ((0, 0), (1, 0), (1, 1), (0, 1)):
                point = corners[side].copy()
                point[right], point[up] = corners[a, right], corners[b, up]
                vertices.append(point)
                uv.append(point[[right, up]])
    faces = [[4 * k + i for i in corner] for k in range(6) for corner in ((0, 1, 2), (0, 2, 3))]
    return Solid(np.array(vertices), np.array(uv), np.array(faces), finish)


def cupboard(rng: np.random.Generator, like: Sequence[Color]) -> list[Solid]:
    """Draw a cupboard or a chest of drawers, with a few things on a low one."""
    width, height, depth = rng.uniform(0.6, 1.4), rng.uniform(0.6, 2.1), rng.uniform(0.35, 0.55)
    piece = [box((0, 0.06, 0), (width, height, depth), doors(rng))]
    return piece + (things(rng, width, height, depth, like) if height < 1.3 else [])


def shelf(rng: np.random.Generator, like: Sequence[Color]) -> list[Solid]:
    """Draw an open shelf with books."""
    width, rows, depth, board = rng.uniform(0.6, 1.2), int(rng.integers(3, 7)), 0.28, 0.02
    timber, step = wood(rng), 0.34
    height = rows * step
    piece = [box((x, 0, 0), (x + board, height, depth), timber) for x in (0, width - board)]
    for k in range(rows + 1):
        piece.append(box((0, k * step, 0), (width, k * step + board, depth), timber))
        if k < rows:
            stands = rng.uniform(0.3, 0.95) * (width - 2 * board) + board
            top = k * step + board + rng.uniform(0.2, 0.3)
            piece.append(box((board, k * step + board, 0), (stands, top, 0.2), books(rng)))
    return piece


def table(rng: np.random.Generator, like: Sequence[Color]) -> list[Solid]:
    """Draw a table with things on it."""
    width, height, depth = rng.uniform(0.8, 1.5), rng.uniform(0.68, 0.78), rng.uniform(0.5, 0.6)
    timber = wood(rng)
    piece = [box((0, height - 0.03, 0), (width, height, depth), timber)]
    for x in (0.02, width - 0.07):
        for z in (0.02, depth - 0.07):
            piece.append(box((x, 0, z), (x + 0.05, height - 0.03, z + 0.05), timber))
    return piece + things(rng, width, height, depth, like)


def sofa(rng: np.random.Generator, like: Sequence[Color]) -> list[Solid]:
    """Draw a sofa or an armchair with cushions."""
    width, depth, seat, arm = rng.uniform(0.8, 1.9), 0.75, 0.42, 0.16
    cover = cloth(rng, like)
    piece = [
        box((0, 0.08, 0), (width, seat, depth), cover),
        box((0, seat, 0), (width, rng.uniform(0.75, 0.95), 0.2), cover),
    ]
    for x in (0, width - arm):
        piece.append(box((x, 0.08, 0), (x + arm, 0.6, depth), cover))
    for _ in range(int(rng.integers(0, 3))):
        x = rng.uniform(arm, max(arm, width - arm - 0.4))
        piece.append(box((x, seat, 0.2), (x + 0.38, seat + 0.36, 0.32), cloth(rng, like)))
    return piece


def plant(rng: np.random.Generator, like: Sequence[Color]) -> list[Solid]:
    """Draw a plant in a pot."""
    count, height = 220, rng.uniform(0.9, 1.6)
    middle = np.array([0.25, 0, 0.25])
    at = rng.normal(0, 1, (count, 3))
    at *= rng.uniform(0.3, 1, (count, 1)) / np.linalg.norm(at, axis=1, keepdims=True)
    at = at * [0.28, 0.5 * (height - 0.4), 0.28] + middle + [0, 0.5 * (height + 0.4), 0]
    along, across = rng.normal(0, 1, (2, count, 3))
    unit = lambda v: v / np.linalg.norm(v, axis=1, keepdims=True)
    along, across = 0.11 * unit(along), 0.03 * unit(across)
    leaves = np.stack([at - along, at + across, at + along, at - across], axis=1)
    faces = np.concatenate([4 * np.arange(count)[:, None] + c for c in ([0, 1, 2], [0, 2, 3])])
    green = Finish(linear(62, 104, 52), rough=0.3)
    uv = leaves.reshape(-1, 3)[:, :2]
    return [
        box((0.1, 0, 0.1), (0.4, 0.35, 0.4), paint(rng)),
        box((0.235, 0.35, 0.235), (0.265, 0.6 * height, 0.265), wood(rng)),
        Solid(leaves.reshape(-1, 3), uv, faces, green),
    ]


def door(rng: np.random.Generator, like: Sequence[Color]) -> list[Solid]:
    """Draw a closed door with its frame."""
    width, frame = 0.86, paint(rng)
    leaf = wood(rng) if rng.random() < 0.5 else paint(rng)
    return [
        box((0.07, 0, 0), (0.07 + width, 2.0, 0.03), leaf),
        box((0, 0, 0), (0.07, 2.07, 0.05), frame),
        box((width + 0.07, 0, 0), (width + 0.14, 2.07, 0.05), frame),
        box((0.07, 2.0, 0), (width + 0.07, 2.07, 0.05), frame),
        box((0.12, 1.0, 0.03), (0.24, 1.03, 0.08), Finish((0.4, 0.4, 0.4))),
    ]


def things(
    rng: np.random.Generator, width: float, height: float, depth: float, like: Sequence[Color]
) -> list[Solid]:
    """Draw a few things that lie on a piece of these measures."""
    found = []
    for _ in range(int(rng.integers(1, 5))):
        size = rng.uniform(0.06, 0.35, 3) * [1, 0.8, 0.6]
        x, z = rng.uniform(0, 1, 2) * (width - size[0], depth - size[2])
        finish = [paint, cloth][int(rng.integers(2))](rng, like)
        found.append(box((x, height, z), (x + size[0], height + size[1], z + size[2]), finish))
    return found


def picture(rng: np.random.Generator) -> list[Solid]:
    """Draw a picture in a frame; x and y start at its lower left corner."""
    width, height, edge = rng.uniform(0.3, 0.9), rng.uniform(0.3, 0.7), 0.03
    return [
        box((0, 0, 0), (width, height, 0.02), wood(rng)),
        box((edge, edge, 0.02), (width - edge, height - edge, 0.022), poster(rng)),
    ]


PIECES = (cupboard, shelf, table, sofa, plant, door)
