"""The room around a synthetic subject, drawn from a seed.

A room is the inside of a box with furniture along its walls. The floor is at y = 0. Lamps shine
through its walls, as if these had windows where no camera looks.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import drjit as dr
import numpy as np
from drjit import ArrayBase as Array
from numpy.random import Generator

from gva_mi.splat import Camera
from gva_mi.synthetic.person.identity import Color, SyntheticPerson
from gva_mi.synthetic.pictures.finishes import Finish, floor, wall
from gva_mi.synthetic.pictures.furniture import PIECES, Solid, picture

# Light, linear, chosen by eye: pictures are exposed as a phone's.
SKY_RADIANCE = (0.58, 0.60, 0.63)  # ambient, from above
INDIRECT_LIGHT = 0.55  # light that a surface sends back, over its albedo
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
