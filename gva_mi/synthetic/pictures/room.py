"""The room around a synthetic subject, drawn from a seed.

A room is the inside of a box with furniture along its walls. The floor is at y = 0. Lamps shine
through its walls, as if these had windows where no camera looks.

Pieces of furniture are boxes and, for plants, leaves. A piece stands against a wall: x runs along
it, y up, z away from it, metres. Each corner of a triangle has its own vertex, with coordinates
(u, v) of its finish. Triangles have no outside: light meets the side that is seen. All pieces are
drawn with a generator ``rng``; ``like`` are colours of the person, which cloth and paint have now
and then.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import numpy as np
from drjit import ArrayBase as Array
from numpy.random import Generator

from gva_mi.splat import Camera
from gva_mi.synthetic.person.identity import Color, SyntheticPerson, linear
from gva_mi.synthetic.pictures.finishes import (
    Finish,
    books,
    cloth,
    doors,
    floor,
    paint,
    poster,
    wall,
    wood,
)
from gva_mi.synthetic.pictures.lights import INDIRECT_LIGHT, SKY_RADIANCE

# Light, linear, chosen by eye: pictures are exposed as a phone's.
CEILING_RADIANCE = 1.25 * np.array(SKY_RADIANCE)  # lit by all that falls on the floor
EXPOSURE_GAIN = 0.95  # factor on light, if walls and floor have a mean albedo of 0.35
BRIGHT_ALBEDO = 0.7  # is not overexposed at this gain
LIGHT_WINDOW = 5  # pixels, side of the squares of eq. 6; chosen: smooths noise, keeps shadows
BOX_SIDES = 6  # of the box: the first finishes, in the order -x, +x, -y, +y, -z, +z
LARGEST_DEPTH = 0.8  # m, of all pieces of furniture: a sofa's 0.75 and some room


@dataclass(frozen=True)
class Room:
    """A box with furniture."""

    low: np.ndarray  # (3,) metres, the corners of the box
    high: np.ndarray
    vertices: np.ndarray  # (N, 3) float32 metres, of all furniture
    uv: np.ndarray  # (N, 2) float32 metres
    faces: np.ndarray  # (F, 3)
    finish: np.ndarray  # (F,) index of a triangle's finish
    finishes: tuple[Finish, ...]  # first of the box's BOX_SIDES
    gain: Color  # exposure and white balance of the camera: factors on the light

    @property
    def ambient(self) -> tuple[np.ndarray, np.ndarray]:
        """Radiance (3,) from below and from above; from the walls it lies between."""
        return INDIRECT_LIGHT * np.array(self.finishes[2].mean_color()), CEILING_RADIANCE

    def exit(self, origin: Array, direction: Array) -> tuple[Array, Array, Array, Array]:
        """Return where rays from inside meet the box: distance, side, u and v in metres."""
        import mitsuba as mi

        far, side = mi.Float(dr.inf), mi.UInt32(0)
        for axis in range(3):
            ahead = direction[axis] > 0
            bound = dr.select(ahead, float(self.high[axis]), float(self.low[axis]))
            t = dr.select(direction[axis] == 0, dr.inf, (bound - origin[axis]) / direction[axis])
            nearer = t < far
            side = dr.select(nearer, 2 * axis + dr.select(ahead, mi.UInt32(1), 0), side)
            far = dr.minimum(far, t)
        point = origin + far * direction
        u = dr.select(side < 2, point.z, point.x)
        v = dr.select((side == 2) | (side == 3), point.z, point.y)
        return far, side, u, v


def draw_room(
    rng: Generator, person: SyntheticPerson, points: np.ndarray, cameras: Sequence[Camera]
) -> Room:
    """Draw a room that holds a person's points (..., 3) of all frames, and all cameras.

    Its walls and cloth sometimes have nearly the colours of the person. The camera's exposure fits
    the colours.
    """
    like = [person.skin, person.top.colors[0], person.bottom.colors[0], person.shoes]
    points = points.reshape(-1, 3)
    eyes = np.stack([camera.position for camera in cameras])
    low, high = points.min(0) - rng.uniform(1.0, 2.4, 3), points.max(0) + rng.uniform(1.0, 2.4, 3)
    low = np.minimum(low, eyes.min(0) - 0.3)
    high = np.maximum(high, eyes.max(0) + 0.3)
    low[1], high[1] = 0, max(high[1], 2.5)
    papered = wall(rng, like)
    walls = [papered if rng.random() < 0.7 else wall(rng, like) for _ in range(4)]
    finishes = [*walls[:2], floor(rng), Finish((0.7, 0.7, 0.7)), *walls[2:]]
    solids = _furnished(rng, low, high, eyes, like)
    starts = np.cumsum([0, *(len(solid.vertices) for solid in solids)])
    join = lambda parts: np.concatenate([*parts])
    bright = np.mean([papered.mean_color(), finishes[2].mean_color()])
    gain = EXPOSURE_GAIN * np.clip(0.35 / bright, 0.5, 2.5) ** 0.5 * rng.uniform(0.85, 1.15)
    gain = min(gain, EXPOSURE_GAIN * BRIGHT_ALBEDO / max(person.skin))
    return Room(
        low, high,
        join(solid.vertices for solid in solids).astype(np.float32),
        join(solid.uv for solid in solids).astype(np.float32),
        join(solid.faces + k for solid, k in zip(solids, starts, strict=False)),
        np.repeat(BOX_SIDES + np.arange(len(solids)), [len(solid.faces) for solid in solids]),
        (*finishes, *(solid.finish for solid in solids)),
        tuple((gain * (1 + rng.normal(0, 0.03, 3))).tolist()),
    )  # fmt: skip


def _furnished(
    rng: Generator, low: np.ndarray, high: np.ndarray, eyes: np.ndarray, like: Sequence[Color]
) -> list[Solid]:
    """Draw furniture along the four walls, none where a camera stands."""
    middle, solids = (low + high) / 2, []
    for quarter in range(4):
        # x along the wall, z into the room: turned by quarter turns about y.
        x = np.array([(1, 0, 0), (0, 0, -1), (-1, 0, 0), (0, 0, 1)][quarter], dtype=np.float64)
        z = np.cross(x, [0, 1, 0])
        reach = np.abs((high - low) / 2)
        length, depth = np.abs(x) @ reach, np.abs(z) @ reach
        corner = np.array([middle[0], 0, middle[2]]) - length * x - depth * z
        corners = LARGEST_DEPTH * (quarter % 2)  # which the other walls' furniture fills
        at = corners + rng.uniform(0.1, 0.6)
        while True:
            piece = PIECES[int(rng.integers(len(PIECES)))](rng, like)
            width = max(solid.vertices[:, 0].max() for solid in piece)
            if at + width > 2 * length - corners - 0.1:
                break
            top = max(solid.vertices[:, 1].max() for solid in piece)
            start = at
            at += width + rng.uniform(0.05, 0.9)
            place = (eyes - corner) @ np.stack([x, z], axis=1)
            beside = np.abs(place[:, 0] - start - width / 2) < width / 2 + 0.3
            if (beside & (place[:, 1] < LARGEST_DEPTH + 0.3)).any() or rng.random() < 0.15:
                continue
            if top < 1.2 and rng.random() < 0.7:
                hung = picture(rng)
                shift = [width / 2 - 0.3, rng.uniform(1.35, 1.7), 0]
                piece += [_moved(solid, np.eye(3), shift) for solid in hung]
            turn = np.stack([x, [0, 1, 0], z], axis=1)
            solids += [_moved(solid, turn, corner + start * x) for solid in piece]
    return solids


def _moved(solid: Solid, turn: np.ndarray, shift: np.ndarray) -> Solid:
    """Turn a solid, then shift it."""
    return Solid(solid.vertices @ turn.T + shift, solid.uv, solid.faces, solid.finish)


def smoothly_lit(room: np.ndarray) -> np.ndarray:
    """Return the radiance (H, W, 3) of a room from its noisy radiance and albedo (H, W, 6).

    See eq. 6 of :mod:`gva_mi.synthetic.pictures.render`.
    """
    from scipy.ndimage import uniform_filter

    window = LIGHT_WINDOW, LIGHT_WINDOW, 1
    light, albedo = (uniform_filter(x, window) for x in np.split(room, 2, axis=-1))
    return room[..., 3:] * light / np.maximum(albedo, 1e-6)


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


def cupboard(rng: Generator, like: Sequence[Color]) -> list[Solid]:
    """Draw a cupboard or a chest of drawers, with a few things on a low one."""
    width, height, depth = rng.uniform(0.6, 1.4), rng.uniform(0.6, 2.1), rng.uniform(0.35, 0.55)
    piece = [box((0, 0.06, 0), (width, height, depth), doors(rng))]
    return piece + (things(rng, width, height, depth, like) if height < 1.3 else [])


def shelf(rng: Generator, like: Sequence[Color]) -> list[Solid]:
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


def table(rng: Generator, like: Sequence[Color]) -> list[Solid]:
    """Draw a table with things on it."""
    width, height, depth = rng.uniform(0.8, 1.5), rng.uniform(0.68, 0.78), rng.uniform(0.5, 0.6)
    timber = wood(rng)
    piece = [box((0, height - 0.03, 0), (width, height, depth), timber)]
    for x in (0.02, width - 0.07):
        for z in (0.02, depth - 0.07):
            piece.append(box((x, 0, z), (x + 0.05, height - 0.03, z + 0.05), timber))
    return piece + things(rng, width, height, depth, like)


def sofa(rng: Generator, like: Sequence[Color]) -> list[Solid]:
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


def plant(rng: Generator, like: Sequence[Color]) -> list[Solid]:
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


def door(rng: Generator, like: Sequence[Color]) -> list[Solid]:
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
    rng: Generator, width: float, height: float, depth: float, like: Sequence[Color]
) -> list[Solid]:
    """Draw a few things that lie on a piece of these measures."""
    found = []
    for _ in range(int(rng.integers(1, 5))):
        size = rng.uniform(0.06, 0.35, 3) * [1, 0.8, 0.6]
        x, z = rng.uniform(0, 1, 2) * (width - size[0], depth - size[2])
        finish = [paint, cloth][int(rng.integers(2))](rng, like)
        found.append(box((x, height, z), (x + size[0], height + size[1], z + size[2]), finish))
    return found


def picture(rng: Generator) -> list[Solid]:
    """Draw a picture in a frame; x and y start at its lower left corner."""
    width, height, edge = rng.uniform(0.3, 0.9), rng.uniform(0.3, 0.7), 0.03
    return [
        box((0, 0, 0), (width, height, 0.02), wood(rng)),
        box((edge, edge, 0.02), (width - edge, height - edge, 0.022), poster(rng)),
    ]


PIECES = (cupboard, shelf, table, sofa, plant, door)
