"""Lights of a synthetic subject: area lamps and a sky, for this package's renderer and for Mitsuba.

``gva-mi synth --light`` chooses one. :meth:`Light.emitters` gives the same lamps and sky as
Mitsuba's plugins, so that an avatar can be relit by the light of a ground truth.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from gva_mi.synthetic.person.identity import Color
from gva_mi.synthetic.person.texture import Point

# Light, linear, chosen by eye: pictures are exposed as a phone's.
SKY_RADIANCE = (0.58, 0.60, 0.63)  # ambient, from above
GROUND_RADIANCE = (0.30, 0.29, 0.28)  # ambient, from below, on white; half of the sky's
INDIRECT_LIGHT = 0.55  # light that a surface sends back, over its albedo
PERSON = np.array([0.0, 0.9, 0.0])  # m, the middle of a person
SKY_ROWS = 33  # of an environment map, pole to pole; chosen: radiance is linear between them


@dataclass(frozen=True)
class AreaLight:
    """A parallelogram that shines on both sides and hides nothing."""

    centre: Point  # metres, world
    u: Point  # half edges; at right angles, as Mitsuba's rectangles are
    v: Point
    radiance: Color  # linear

    def turned(self) -> AreaLight:
        """Return the lamp after a quarter turn about the vertical axis, from left to right."""
        quarter = lambda x: (x[2], x[1], -x[0])
        return AreaLight(quarter(self.centre), quarter(self.u), quarter(self.v), self.radiance)

    @property
    def to(self) -> np.ndarray:
        """The vector (3,) from the person to the lamp, metres."""
        return np.array(self.centre) - PERSON

    @property
    def irradiance(self) -> np.ndarray:
        """Irradiance (3,) on a surface at the person that faces the lamp, times its direction."""
        area = 4 * abs(np.cross(self.u, self.v) @ self.to)
        return np.mean(self.radiance) * area / np.linalg.norm(self.to) ** 4 * self.to

    def emitter(self, behind: np.ndarray) -> dict[str, Any]:
        """Return a rectangle of Mitsuba that shines on the person.

        Here lamps hide nothing. There they do, so the rectangle adds the radiance ``behind`` it.
        """
        import mitsuba as mi

        u, v, centre = (np.array(x) for x in (self.u, self.v, self.centre))
        if np.cross(u, v) @ (PERSON - centre) < 0:
            u, v = v, u
        normal = np.cross(u, v) / np.linalg.norm(np.cross(u, v))
        to_world = np.eye(4)
        to_world[:3] = np.stack([u, v, normal, centre], axis=1)
        radiance = {"type": "rgb", "value": (self.radiance + behind).tolist()}
        return {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f(to_world),
            "emitter": {"type": "area", "radiance": radiance},
        }


@dataclass(frozen=True)
class Light:
    """Lamps, and a sky whose radiance is linear in the height of the direction.

    In a room, its walls take the place of the sky.
    """

    lamps: tuple[AreaLight, ...]
    sky: Color = SKY_RADIANCE  # from straight above
    ground: Color = GROUND_RADIANCE  # from straight below
    # Light that surfaces send back, over their albedo: the mean irradiance over π where nothing
    # shades them.
    indirect: Color = (INDIRECT_LIGHT,) * 3

    @property
    def direction(self) -> np.ndarray:
        """The unit vector (3,) to where most of the lamps' light comes from; up without lamps."""
        total = sum((lamp.irradiance for lamp in self.lamps), np.zeros(3))
        return total / np.linalg.norm(total) if self.lamps else np.array([0.0, 1.0, 0.0])

    def emitters(self) -> dict[str, dict[str, Any]]:
        """Return the lamps and the sky as entries of a dictionary for ``mitsuba.load_dict``."""
        import mitsuba as mi

        rows = self._ambient(np.cos(np.linspace(0, np.pi, SKY_ROWS)))
        pixels = np.repeat(rows[:, None], 2 * SKY_ROWS, axis=1).astype(np.float32)
        heights = [lamp.to[1] / np.linalg.norm(lamp.to) for lamp in self.lamps]
        behind = self._ambient(np.array(heights))
        lamps = {f"lamp{k}": lamp.emitter(behind[k]) for k, lamp in enumerate(self.lamps)}
        return lamps | {"sky": {"type": "envmap", "bitmap": mi.Bitmap(pixels)}}

    def _ambient(self, height: np.ndarray) -> np.ndarray:
        """Return the sky's radiance (n, 3) from unit vectors with the heights (n,)."""
        sky, ground = np.array(self.sky), np.array(self.ground)
        return ground + (sky - ground) * (0.5 + 0.5 * height[:, None])


def _with_sky(lamp: AreaLight | None, sky: float, indirect: Color) -> Light:
    """Return a light of at most one lamp whose sky is ``sky`` times as bright as usual."""
    above, below = (tuple(sky * x for x in c) for c in (SKY_RADIANCE, GROUND_RADIANCE))
    return Light((lamp,) if lamp else (), above, below, indirect)


_KEY = AreaLight((-2.2, 3.0, 3.0), (0.7, 0.0, 0.5), (-0.4, 0.6, 0.55), (15.0, 14.5, 13.8))
_FILL = AreaLight((3.2, 1.6, 2.2), (0.5, 0.0, -0.75), (0.0, 0.9, 0.0), (1.6, 1.7, 1.9))
_SIDE = AreaLight((-3.6, 1.4, 0.0), (0.0, 0.8, 0.0), (0.0, 0.0, 0.8), (24.0, 23.2, 22.1))
_WARM = AreaLight((3.0, 2.2, 1.2), (-0.25, 0.0, 0.62), (-0.3, 0.55, -0.12), (26.0, 21.0, 14.0))
_ABOVE = AreaLight((0.3, 3.6, 0.3), (0.6, 0.0, 0.0), (0.0, 0.0, 0.6), (18.0, 18.0, 18.0))

# Usual: a key light at the upper left of the camera and a weak fill light to the right, both metres
# wide. Side: one lamp to the left, which lights a turning person from all sides. The others are for
# ground truth of relighting.
LIGHTS = {
    "usual": Light((_KEY, _FILL)),
    "side": Light((_SIDE,)),
    "turned": Light((_KEY.turned(), _FILL.turned())),
    "right": _with_sky(_WARM, 0.35, (0.44, 0.39, 0.31)),
    "left": _with_sky(_SIDE, 0.35, (0.52, 0.51, 0.50)),
    "above": _with_sky(_ABOVE, 0.35, (0.43, 0.43, 0.43)),
    "sky": _with_sky(None, 1.6, (0.70, 0.71, 0.73)),
}
