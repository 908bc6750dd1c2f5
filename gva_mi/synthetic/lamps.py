"""Lamps and the sky: what lights a synthetic subject."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class AreaLight:
    """A parallelogram that emits light on one side."""

    centre: tuple[float, float, float]  # metres, world
    u: tuple[float, float, float]  # half edges; u × v points to the emitting side
    v: tuple[float, float, float]
    radiance: tuple[float, float, float]  # linear


# Besides the sky. Usual: a key light at the upper left of the camera and a weak fill light to the
# right, both metres wide. Side: one lamp to the left, which lights a turning person from all sides.
LIGHTS = {
    "usual": (
        AreaLight((-2.2, 3.0, 3.0), (0.7, 0.0, 0.5), (-0.4, 0.6, 0.55), (15.0, 14.5, 13.8)),
        AreaLight((3.2, 1.6, 2.2), (0.5, 0.0, -0.75), (0.0, 0.9, 0.0), (1.6, 1.7, 1.9)),
    ),
    "side": (AreaLight((-3.6, 1.4, 0.0), (0.0, 0.8, 0.0), (0.0, 0.0, 0.8), (24.0, 23.2, 22.1)),),
    "ambient": (),
}
SKY, EARTH = (0.58, 0.60, 0.63), (0.30, 0.29, 0.28)  # ambient radiance from above and from below
