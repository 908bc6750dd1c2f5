"""Hair as one closed surface: a cap on the skull, and for longer cuts a volume that stands off it.

    f = smax( smin( d - thickness, volume ), -face, d - rise )      see ``garments`` for smax, d

with ``face`` the distance from the opening for the face, negative in it, and ``rise`` the most that
hair may stand off the skin there: it grows from the hairline, and is no hood. Long hair falls
behind the shoulders, over what is worn there. Locks are a modulation of the thickness around the
head; single strands are left to the texture.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np

from gva_mi.data.synthetic.garments import (
    HAIR_CELL,
    BodySurface,
    Grid,
    Mesh,
    smax,
    smin,
    smoothstep,
    surface_of,
)

DRAPED = 0.014  # m, thickness of long hair on the back, over the cloth below it
HAIRLINE, RISE = 0.007, 1.1  # m, thickness at the hairline; its growth per metre from there
EAR = 0.034  # m, what a short cut leaves free around an ear

HairStyle = Literal["short", "bob", "long"]


def hair(
    surface: BodySurface,
    joints: Mapping[str, np.ndarray],
    style: HairStyle,
    thick: float,
    rng: np.random.Generator,
    worn: BodySurface | None = None,
) -> Mesh:
    """The hair of a head.

    Args:
        surface: the body.
        joints: rest positions by name.
        style: "short" follows the skull; "bob" hangs to the jaw, centimetres off the head; "long"
            to the shoulder blades.
        thick: thickness on the skull, metres.
        rng: for the locks and the parting.
        worn: the shirt that long hair falls over.
    """
    eyes = (joints["left_eye_smplhf"] + joints["right_eye_smplhf"]) / 2
    neck = joints["neck"]
    skull = surface.points[surface.points[:, 1] > eyes[1] - 0.02]
    top = skull[:, 1].max()
    unit = (top - eyes[1]) / 0.115  # 1 for the heads these numbers were made for
    half = np.ptp(skull, axis=0) / 2
    middle = (skull.max(0) + skull.min(0)) / 2
    jaw = eyes[1] - 0.105 * unit
    ends = {"short": eyes[1] - 0.08 * unit, "bob": jaw - 0.005 * unit, "long": neck[1] - 0.12}[
        style
    ]

    reach = np.array([half[0] + 0.09, 0, half[2] + 0.10])
    grid = Grid.around(
        [middle[0] - reach[0], ends - 0.03, middle[2] - reach[2]],
        [middle[0] + reach[0], top + 0.06, middle[2] + reach[2]],
        HAIR_CELL,
    )
    d = surface.sample(grid)
    x, y, z = grid.x - middle[0], grid.y, grid.z - middle[2]
    angle = np.arctan2(z, x)
    fall = smoothstep(top - y, 0.02, 0.25)  # 0 on the crown, 1 at the ends
    locks = sum(
        np.cos(n * angle + rng.uniform(0, 2 * np.pi) + rng.uniform(-15, 15) * y) / 3
        for n in (9, 14, 23)
    )
    parting = np.exp(-(((x - rng.choice([-1, 1]) * 0.028) / 0.012) ** 2)) * (z > -0.3 * half[2])
    uncut = d - thick * (1 + 0.25 * locks * (0.4 + fall)) + 0.004 * parting * (y > eyes[1] + 0.06)

    # The face: an ellipse in front, open downward, so that no hair lies on cheeks and chin.
    width, brow = 0.062 * unit, eyes[1] + 0.055 * unit
    centre = eyes[1] - 0.03 * unit
    up = np.where(y > centre, (y - centre) / (brow - centre), 0.0)
    face = (np.sqrt((x / width) ** 2 + up**2) - 1) * width
    face = smax(face, (0.10 * half[2] - z) + 0 * face, 0.02)
    below = np.maximum(eyes[1] - y, 0)
    rise = HAIRLINE + RISE * np.maximum(face, 0) + 0.8 * below

    if style == "short":
        # A slanting line from the temples over the ears to the nape.
        line = eyes[1] + 0.015 * unit + np.where(z > 0, 0.15, 0.75) * z
        field = smax(uncut, line - y + 0 * uncut, 0.015)
        field = smax(field, ends - y + 0 * uncut)
        field = smax(field, -_around_ears(surface, grid, eyes, middle), 0.012)
    else:
        stand = {"bob": 0.034, "long": 0.026}[style] * unit
        tuck = 0.12 * below if style == "bob" else 0.25 * np.maximum(below - 0.06, 0)
        half_x = half[0] + stand - tuck
        half_z = half[2] + np.where(z > 0, 0.45, 1.0) * stand - 0.3 * tuck
        back = z + (0.0 if style == "bob" else 0.12) * below  # long hair falls onto the back
        wave = 1 + 0.022 * locks * fall
        over = np.maximum(y - eyes[1], 0) / (top + thick - eyes[1])
        volume = np.sqrt((x / half_x) ** 2 + (back / half_z) ** 2 + over**2) / wave
        volume = (volume - 1) * np.minimum(half_x, half_z)
        if style == "long":
            # Behind the shoulders only, and narrower there than they are.
            front = 0.06 * smoothstep(y, neck[1], jaw) + np.where(y > jaw, 10 * (y - jaw), 0)
            behind = z - front + 0.35 * half[2]
            volume = smax(volume, behind + 0 * x, 0.03)
            if worn is not None:
                lies = worn.sample(grid) - DRAPED * (1 + 0.3 * locks)
                volume = smin(volume, smax(lies, smax(volume - 0.03, behind + 0 * x), 0.02), 0.02)
        scalp = smax(uncut, jaw - y + 0 * uncut)
        uncut = smin(scalp, volume, 0.02)
        field = smax(uncut, ends + 0.006 * locks - y + 0 * uncut, 0.015)
    field = smax(field, d - rise, 0.01)
    return surface_of(grid, smax(field, -face, 0.012), None if style == "short" else uncut)


def _around_ears(
    surface: BodySurface, grid: Grid, eyes: np.ndarray, middle: np.ndarray
) -> np.ndarray:
    """Distance from a ball around each ear: the widest points of the head at the eyes' height."""
    level = np.abs(surface.points[:, 1] - eyes[1]) < 0.03
    side = surface.points[level & (surface.points[:, 2] < eyes[2] - 0.03)]
    ear = side[np.argsort(-np.abs(side[:, 0] - middle[0]))[:20]].mean(0)
    across = np.abs(side[:, 0] - middle[0]).max()
    x = np.abs(grid.x - middle[0]) - across
    return np.sqrt(x**2 + (grid.y - ear[1]) ** 2 + (grid.z - ear[2]) ** 2) - EAR
