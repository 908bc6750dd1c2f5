"""Colours and patterns of a synthetic subject, their places on its rest surface, and its lamps.

Colours are linear albedo with Rec. 709 primaries; points are in the rest pose, metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Literal

import drjit as dr
import numpy as np
from drjit import ArrayBase as Array

Color = tuple[float, float, float]  # linear albedo
Point = tuple[float, float, float]
Pattern = Literal["smooth", "plain", "stripes", "plaid", "dots", "print"]


class Material(IntEnum):
    """The material of a triangle."""

    SKIN, TOP, BOTTOM, SHOES, HAIR, ACCESSORY = range(6)


@dataclass(frozen=True)
class Fabric:
    """Pattern and colours of a cloth; "plain" has only a weave, "smooth" nothing."""

    pattern: Pattern
    colors: tuple[Color, Color, Color]  # ground, figure, thin lines; linear albedo
    scale: float  # m, one repeat of the pattern


@dataclass(frozen=True)
class FaceLandmarks:
    """Landmarks of the painted face."""

    eyes: tuple[Point, Point]  # left, right
    mouth: Point
    unit: float  # distance between the eyes


@dataclass(frozen=True)
class SkirtCone:
    """The cone of a skirt, whose cloth is unrolled so that patterns keep their size."""

    apex: Point  # metres
    slope: float  # radius per metre below the apex
    aspect: float  # width over depth

    def unrolled(self, p: Array) -> tuple[Array, Array]:
        """Unroll points onto the flat cloth, metres along and around; the seam is behind."""
        sine = self.slope / np.sqrt(1 + self.slope**2)
        slant = (self.apex[1] - p.y) * float(np.sqrt(1 + self.slope**2))
        angle = dr.atan2(p.x - self.apex[0], self.aspect * (p.z - self.apex[2])) * float(sine)
        return -slant * dr.cos(angle), slant * dr.sin(angle)

    def share(self, p: Array) -> Array:
        """Return the relative distance of points from the axis, 0 on it and 1 on the cone."""
        depth = p.z - self.apex[2]
        out = dr.sqrt(dr.square((p.x - self.apex[0]) / self.aspect) + dr.square(depth))
        return 0.5 * (1 + self.aspect) * out / (self.slope * (self.apex[1] - p.y))


@dataclass(frozen=True)
class Look:
    """Colours and landmarks that the texture is computed from."""

    skin: Color
    lips: Color
    iris: Color
    hair: Color
    brows: Color
    top: Fabric
    bottom: Fabric
    shoes: Color
    swimsuit: bool  # painted on the skin, for a person without clothes
    face: FaceLandmarks
    nails: tuple[Point, ...]  # centres, on the backs of the fingers
    shoulder: Point  # left shoulder; sleeves begin here
    hip: Point  # left hip
    ground: float  # m, height of the soles
    accessory: Color = (0.02, 0.02, 0.02)
    cone: SkirtCone | None = None  # of a skirt

    def mean_color(self, material: Material) -> Color:
        """Return the average colour of a material, for indirect light."""
        fabric = {Material.TOP: self.top, Material.BOTTOM: self.bottom}.get(material)
        if fabric is not None:
            a, b = np.array(fabric.colors[0]), np.array(fabric.colors[1])
            return tuple(0.6 * a + 0.4 * b)
        plain = {Material.SKIN: self.skin, Material.SHOES: self.shoes, Material.HAIR: self.hair}
        return plain.get(material, self.accessory)


@dataclass(frozen=True)
class AreaLight:
    """A parallelogram that emits light on one side."""

    centre: Point  # metres, world
    u: Point  # half edges; u × v points to the emitting side
    v: Point
    radiance: Color  # linear


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


def linear(*srgb: int) -> Color:
    """Convert an 8-bit sRGB colour to linear albedo."""
    c = np.array(srgb, dtype=np.float64) / 255
    return tuple(float(x) for x in np.where(c <= 0.04045, c / 12.92, ((c + 0.055) / 1.055) ** 2.4))


def encode(linear_rgb: np.ndarray) -> np.ndarray:
    """Encode linear light as sRGB in [0, 1], float32."""
    x = np.clip(linear_rgb, 0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055).astype(np.float32)


def palette(rng: np.random.Generator, colors: Sequence[Color]) -> Color:
    """Draw one of the colours, slightly varied."""
    color = np.array(colors[rng.integers(len(colors))])
    return tuple(float(c) for c in np.clip(color * rng.uniform(0.85, 1.15, 3), 0.01, 0.85))
