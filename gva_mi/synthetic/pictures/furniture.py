"""Pieces of furniture for a room, made of boxes and, for plants, of leaves.

A piece stands against a wall: x runs along it, y up, z away from it, metres. Each corner of a
triangle has its own vertex, with coordinates (u, v) of its finish. Triangles have no outside: light
meets the side that is seen. All pieces are drawn with a generator ``rng``; ``like`` are colours of
the person, which cloth and paint have now and then.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from gva_mi.synthetic.person.identity import Color, linear
from gva_mi.synthetic.pictures.finishes import Finish, books, cloth, doors, paint, poster, wood


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
