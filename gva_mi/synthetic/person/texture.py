"""Colours of skin, cloth and hair: formulas of the rest position, sharp at any resolution.

Nothing is baked into a bitmap: the colour of a point is computed from its position in the rest
pose, metres, on Dr.Jit arrays, and from a :class:`Look`.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import drjit as dr
import numpy as np
from drjit import ArrayBase as Array

from gva_mi.synthetic.person.identity import Color, Fabric, SyntheticPerson

Point = tuple[float, float, float]  # metres


class Material(IntEnum):
    """The material of a triangle."""

    SKIN, TOP, BOTTOM, SHOES, HAIR = range(5)


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
    """What the texture is computed from: a person's colours, and landmarks of its body."""

    person: SyntheticPerson
    swimsuit: bool  # painted on the skin, for a bare person
    face: FaceLandmarks
    nails: tuple[Point, ...]  # centres, on the backs of the fingers
    shoulder: Point  # left shoulder; sleeves begin here
    hip: Point  # left hip
    ground: float  # m, height of the soles
    cone: SkirtCone | None = None  # of a skirt

    def mean_color(self, material: Material) -> Color:
        """Return the average colour of a material, for indirect light."""
        person = self.person
        if material in (Material.TOP, Material.BOTTOM):
            fabric = person.top if material is Material.TOP else person.bottom
            a, b = np.array(fabric.colors[0]), np.array(fabric.colors[1])
            return tuple(0.6 * a + 0.4 * b)
        plain = {Material.SHOES: person.shoes, Material.HAIR: person.hair}
        return plain.get(material, person.skin)


def albedo(look: Look, material: Array, rest: Array) -> Array:
    """Return the linear albedo, a Dr.Jit ``Array3f``, at points of the rest surface.

    ``material`` are values of :class:`Material`, a Dr.Jit integer array, and ``rest`` positions in
    the rest pose, an ``Array3f``.
    """
    color = _skin(look, rest)
    parts = {
        Material.TOP: _top, Material.BOTTOM: _bottom, Material.SHOES: _shoes, Material.HAIR: _hair
    }  # fmt: skip
    for part, formula in parts.items():
        color = dr.select(material == int(part), formula(look, rest), color)
    return color


def _skin(look: Look, p: Array) -> Array:
    """Skin with cheeks, brows, eyes, lips, nails and, without clothes, a swimsuit."""
    face = look.face
    base = type(p)(*look.person.skin)
    blotches = value_noise(p * 35) * 0.10 + value_noise(p * 140) * 0.05
    color = base * (1 + blotches)

    painted = color
    for eye in face.eyes:
        painted = _around_eye(look, p, painted, eye)
    painted = _mouth(look, p, painted)
    color = dr.select(p.z > face.mouth[2] - 0.75 * face.unit, painted, color)

    nail_color = dr.minimum(1.15 * base + type(p)(0.13, 0.09, 0.08), 0.85)
    for nail in look.nails:
        d = dr.square(p.x - nail[0]) / 0.0058**2 + dr.square(p.z - nail[2]) / 0.0046**2
        on = dr.select(p.y > nail[1] - 0.003, _inside(1 - d, 0.25), 0.0)
        color = dr.lerp(color, nail_color, 0.9 * on)
    if look.swimsuit:
        suit = _inside(look.shoulder[1] - 0.10 - p.y, 0.003)
        suit *= _inside(p.y - look.hip[1] + 0.08, 0.003)
        suit *= _inside(look.shoulder[0] + 0.02 - dr.abs(p.x), 0.003)
        color = dr.lerp(color, _cloth(look.person.top, p, p.y, dr.atan2(p.z, p.x) * 0.16), suit)
    return color


def _around_eye(look: Look, p: Array, color: Array, eye: Point) -> Array:
    """Paint cheek, brow and eye over ``color``; ``eye`` is its centre."""
    like, unit = type(p), look.face.unit
    outward = 1.0 if eye[0] > 0 else -1.0
    dx, dy = (p.x - eye[0]) / unit, (p.y - eye[1]) / unit
    cheek = dr.exp(-(dr.square(dx - 0.12 * outward) + dr.square(dy + 0.55)) / 0.10)
    color = dr.lerp(color, color * like(1.08, 0.80, 0.78), 0.7 * cheek)
    u = (dx - 0.05 * outward) * outward
    arc = dy - (0.44 - 0.30 * dr.square(u + 0.06))  # inner ends no lower than outer: no scowl
    brow = _inside(0.038 + 0.025 * (0.3 - u) - dr.abs(arc), 0.02)
    brow *= _inside(0.40 - dr.abs(u), 0.06)
    color = dr.lerp(color, like(*(0.5 * c for c in look.person.hair)), 0.85 * brow)
    lid = dr.square(dx / 0.235) + dr.square(dy / dr.select(dy > 0, 0.125, 0.095))
    shadow = _inside(1.9 - lid, 0.9)
    color = dr.lerp(color, color * like(0.76, 0.66, 0.64), shadow)
    inside = _inside(1 - lid, 0.10)
    radius = dr.sqrt(dr.square(dx) + dr.square(dy - 0.005))
    ball = dr.lerp(like(0.78, 0.74, 0.71), like(*look.person.iris), _inside(0.098 - radius, 0.012))
    ball = dr.lerp(ball, like(0.012), _inside(0.045 - radius, 0.012))
    glint = dr.square(dx + 0.03) + dr.square(dy - 0.035)
    ball = dr.lerp(ball, like(0.9), _inside(0.0005 - glint, 0.0003))
    color = dr.lerp(color, ball, inside)
    lash = _inside(0.25 - dr.abs(lid - 1.05), 0.1) * _inside(dy - 0.02, 0.03)
    return dr.lerp(color, like(0.02, 0.012, 0.01), lash)


def _mouth(look: Look, p: Array, color: Array) -> Array:
    """Paint lips and the dark gap between them over ``color``."""
    like, face = type(p), look.face
    dx, dy = (p.x - face.mouth[0]) / face.unit, (p.y - face.mouth[1]) / face.unit
    bow = 0.085 * (1 - dr.square(dx / 0.40)) - 0.02 * dr.exp(-dr.square(dx / 0.06))
    lips = _inside(dr.select(dy > 0, bow * 0.85, bow * 1.15) - dr.abs(dy), 0.02)
    lips *= _inside(0.40 - dr.abs(dx), 0.02)
    red = like(*(c * f for c, f in zip(look.person.skin, (0.80, 0.45, 0.45), strict=True)))
    mouth = dr.lerp(color, red, lips)
    gap = _inside(0.012 - dr.abs(dy - 0.01 * dr.cos(9 * dx)), 0.01)
    gap *= _inside(0.37 - dr.abs(dx), 0.03)
    return dr.lerp(mouth, like(0.06, 0.015, 0.012), 0.85 * gap)


def _top(look: Look, p: Array) -> Array:
    """Shirt: the pattern runs along the sleeves, and a seam joins them to the trunk."""
    side = dr.abs(p.x)
    seam = look.shoulder[0] + 0.02
    arm_level = p.y > look.shoulder[1] - 0.25  # wide hips extend past the seam too
    sleeve = (side > seam) & arm_level
    # Over the level shoulders the cloth continues backwards and down.
    level = dr.clip((p.y - look.shoulder[1] + 0.08) / 0.10, 0, 1)
    over = level * (0.09 - dr.abs(p.z - look.shoulder[2]))
    along = dr.select(sleeve, side + 0.31, p.y + over)
    arm = dr.atan2(p.z - look.shoulder[2], p.y - look.shoulder[1])
    # Nearly x in front, and finite where the cloth closes around the neck.
    trunk = dr.atan2(p.x, dr.abs(p.z) + 0.10) * 0.2
    around = dr.select(sleeve, arm * 0.065, trunk)
    color = _cloth(look.person.top, p, along, around)
    if look.person.top.pattern == "print":
        color = _print(look.person.top, color, p, look.shoulder[1] - 0.13)
    sewn = dr.select(arm_level, _inside(0.0022 - dr.abs(side - seam), 0.001), 0.0)
    return color * (1 - 0.25 * sewn)


def _bottom(look: Look, p: Array) -> Array:
    """Trousers, or a skirt with its lining, with side seams."""
    seam = _inside(0.0025 - dr.abs(p.z - look.hip[2]), 0.001)
    lining = dr.mask_t(p.x)(False)
    if look.cone is not None:
        along, around = look.cone.unrolled(p)
        lining = look.cone.share(p) < 0.75
    else:
        leg = p.y < look.hip[1] - 0.06
        about_leg = dr.atan2(p.z, dr.abs(p.x) - look.hip[0]) * 0.085
        along, around = p.y, dr.select(leg, about_leg, dr.atan2(p.z, p.x) * 0.16)
    color = _cloth(look.person.bottom, p, along, around)
    side_seam = dr.select(dr.abs(p.x) > look.hip[0], seam, 0.0)
    color = dr.select(lining, type(p)(*look.person.bottom.colors[0]), color)
    return color * (1 - 0.25 * side_seam)


def _shoes(look: Look, p: Array) -> Array:
    """Shoes with laces and a pale sole."""
    like = type(p)
    color = like(*look.person.shoes) * (1 + 0.15 * value_noise(p * 90))
    height = p.y - look.ground
    toe = p.z - look.hip[2]
    laces = _inside(0.0035 - dr.abs(dr.abs((toe * 45) - dr.round(toe * 45)) / 45 - 0.004), 0.001)
    middle = dr.abs(dr.abs(p.x) - look.hip[0] - 0.022) < 0.02
    on_top = middle & (toe > 0.0) & (toe < 0.075) & (height > 0.05)
    color = dr.lerp(color, like(0.75), dr.select(on_top, laces, 0.0))
    return dr.lerp(color, like(0.72, 0.70, 0.66), _inside(0.016 - height, 0.001))


def _hair(look: Look, p: Array) -> Array:
    """Hair: locks and strands that vary fast around the head and slowly down it, and a gloss.

    The gloss is a band around the crown, where hair turns from the sky to the side, frayed by the
    strands: without it, hair of one colour looks like felt. Ends are paler than roots.
    """
    _, eye_y, eye_z = look.face.eyes[0]
    x, y, z = p.x, p.y - eye_y - 0.14, p.z - eye_z + 0.11
    around = dr.atan2(z, x)
    polar = dr.atan2(dr.sqrt(dr.square(x) + dr.square(z)), y)
    noise = lambda fast, slow, which: value_noise(type(p)(around * fast, polar * slow, which))
    strands = noise(40, 6, 0.5) * 0.55 + noise(130, 12, 7.5) * 0.45
    shade = 1 + 0.75 * strands + 0.3 * noise(11, 3, 3.5)
    band = dr.exp(-dr.square((y + 0.062 - 0.022 * noise(24, 1, 5.5)) / 0.022))
    paler = 0.5 * dr.clip(-(y + 0.12) / 0.3, 0, 1)
    gloss = 0.9 * band * (0.6 + 0.4 * strands)
    return type(p)(*look.person.hair) * (dr.maximum(shade, 0.15) * (1 + paler)) + 0.06 * gloss


def _cloth(fabric: Fabric, p: Array, along: Array, around: Array) -> Array:
    """Return the pattern of a fabric at positions ``along`` and ``around`` a limb, metres."""
    like = type(p)
    ground, figure, line = (like(*c) for c in fabric.colors)
    band = lambda t, width: _inside(width - dr.abs(t - dr.round(t)), 0.01)
    s, t = along / fabric.scale, around / fabric.scale
    color = ground
    if fabric.pattern == "stripes":
        color = dr.lerp(color, figure, band(s, 0.25))
        color = dr.lerp(color, line, band(s + 0.5, 0.035))
    elif fabric.pattern == "plaid":
        color = dr.lerp(color, figure, 0.5 * (band(s, 0.22) + band(t, 0.22)))
        color = dr.lerp(color, line, 0.8 * dr.maximum(band(s + 0.5, 0.03), band(t + 0.5, 0.03)))
    elif fabric.pattern == "dots":
        row = dr.round(s)
        shifted = t + 0.5 * (row - 2 * dr.floor(row / 2))
        distance = dr.sqrt(dr.square(s - row) + dr.square(shifted - dr.round(shifted)))
        color = dr.lerp(color, figure, _inside(0.27 - distance, 0.02))
    if fabric.pattern == "smooth":
        return color
    weave = 0.10 * value_noise(p * 260) + 0.06 * value_noise(p * 25)
    return color * (1 + weave)


def _print(fabric: Fabric, color: Array, p: Array, height: float) -> Array:
    """Print a motif on the chest and another on the back."""
    like = type(p)
    x, y = p.x, p.y - height
    radius, angle = dr.sqrt(dr.square(x) + dr.square(y)), dr.atan2(y, x)
    star = 0.055 + 0.022 * dr.cos(5 * (angle - np.pi / 2))
    chest = dr.lerp(color, like(*fabric.colors[1]), _inside(0.095 - radius, 0.001))
    chest = dr.lerp(chest, like(*fabric.colors[2]), _inside(star - radius, 0.001))
    bars = _inside(0.012 - dr.abs(dr.abs(x) - 0.03), 0.001) * _inside(0.09 - dr.abs(y), 0.001)
    back = dr.lerp(color, like(*fabric.colors[1]), bars)
    return dr.select(p.z > 0, chest, back)


def _inside(x: Array, width: float) -> Array:
    """Soft step: 1 where ``x`` > 0, blurred over ``width``."""
    return dr.clip(x / width + 0.5, 0, 1)


def value_noise(p: Array) -> Array:
    """Value noise in [-1, 1] on the integer lattice."""
    cell = dr.floor(p)
    f = p - cell
    f = f * f * (3 - 2 * f)
    corner = lambda dx, dy, dz: hash01(cell.x + dx, cell.y + dy, cell.z + dz)
    edge = lambda dy, dz: dr.lerp(corner(0, dy, dz), corner(1, dy, dz), f.x)
    plane = lambda dz: dr.lerp(edge(0, dz), edge(1, dz), f.y)
    return dr.lerp(plane(0), plane(1), f.z) * 2 - 1


def hash01(*lattice: Array) -> Array:
    """Hash an integer lattice point to a number in [0, 1)."""
    Int = dr.int32_array_t(type(lattice[0]))
    UInt = dr.uint32_array_t(Int)
    h = UInt(0)
    for coordinate, prime in zip(lattice, (0x8DA6B343, 0xD8163841, 0xCB1AB31F), strict=True):
        h ^= UInt(Int(coordinate)) * prime
    h ^= h >> 15
    h *= 0x2C1B3C6D
    h ^= h >> 12
    h *= 0x297A2D39
    h ^= h >> 15
    return type(lattice[0])(h >> 8) * (1 / (1 << 24))
