"""Synthetic persons: shape, colours, clothes and hair, drawn from a seed or one of four by name.

The four cover what is hard for an avatar: hair away from the head, a skirt, cloth without texture.
Colours are linear albedo with Rec. 709 primaries.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.random import Generator

from gva_mi.core.srgb import decoded

Color = tuple[float, float, float]  # linear albedo
Pattern = Literal["smooth", "plain", "stripes", "plaid", "dots", "print"]
HairStyle = Literal["short", "bob", "long"]


@dataclass(frozen=True)
class Fabric:
    """Pattern and colours of a cloth; "plain" has only a weave, "smooth" nothing."""

    pattern: Pattern
    colors: tuple[Color, Color, Color]  # ground, figure, thin lines; linear albedo
    scale: float  # m, one repeat of the pattern


def linear(*srgb: int) -> Color:
    """Convert an 8-bit sRGB colour to linear albedo."""
    c = np.array(srgb, dtype=np.float64) / 255
    return tuple(map(float, decoded(c)))


def palette(rng: Generator, colors: Sequence[Color]) -> Color:
    """Draw one of the colours, slightly varied."""
    color = np.array(colors[rng.integers(len(colors))])
    return tuple(float(c) for c in np.clip(color * rng.uniform(0.85, 1.15, 3), 0.01, 0.85))


# Palettes in 8-bit sRGB, chosen by eye: common colours.
_linear = lambda *colors: [linear(*c) for c in colors]
SKINS = _linear((232, 190, 165), (214, 165, 135), (190, 135, 102), (146, 98, 72), (104, 68, 50))
HAIRS = _linear((38, 28, 24), (70, 45, 30), (120, 78, 45), (176, 132, 78), (60, 58, 60))
IRISES = _linear((70, 45, 30), (75, 105, 125), (85, 105, 70), (50, 35, 28))
CLOTHS = _linear(
    (180, 40, 45), (30, 60, 110), (235, 230, 220), (45, 90, 75), (225, 165, 50), (60, 60, 68),
    (130, 155, 190), (120, 55, 95), (205, 120, 90), (25, 28, 38), (150, 175, 140),
)  # fmt: skip
DENIMS = _linear((45, 60, 90), (75, 85, 105), (38, 40, 46), (125, 110, 85))


@dataclass(frozen=True)
class Outfit:
    """The cut of clothes and hair."""

    sleeve: float  # end of the sleeves in (0, 2): 1 is the elbow, 2 the wrist
    hem: float  # m, end of the shirt below the pelvis
    loose: float  # m, distance of the shirt from the body
    bottom: str  # "trousers", "shorts" or "skirt"
    length: float  # end of the bottom in (0, 2): 1 is the knee, 2 the ankle
    flare: float  # trousers: m, distance of the hem; skirt: growth of its radius per metre
    hair: HairStyle
    hair_thick: float  # m
    sole: float = 0.0  # m, thickness added to the flat soles


@dataclass(frozen=True)
class SyntheticPerson:
    """A synthetic subject's shape coefficients, colours and outfit."""

    seed: int  # seed of everything else: folds, locks, motion, errors
    betas: tuple[float, ...]  # standard deviations
    skin: Color
    hair: Color
    iris: Color
    top: Fabric
    bottom: Fabric
    shoes: Color
    outfit: Outfit

    @staticmethod
    def draw(seed: int, num_betas: int) -> SyntheticPerson:
        """Draw a person from a seed, for a body with ``num_betas`` shape coefficients."""
        rng = np.random.default_rng([seed, 0])
        betas = np.clip(rng.normal(0, 0.7, min(10, num_betas)), -1.4, 1.4)
        outfit = _draw_outfit(rng)
        skin, hair = palette(rng, SKINS), palette(rng, HAIRS)
        colors = [CLOTHS[k] for k in rng.permutation(len(CLOTHS))]
        patterns = ["stripes", "plaid", "print", "dots", "plain"]
        top = Fabric(
            str(rng.choice(patterns, p=[0.3, 0.25, 0.25, 0.1, 0.1])),
            (colors[0], colors[1], colors[2]),
            float(rng.uniform(0.05, 0.085)),
        )
        denim = palette(rng, DENIMS)
        bottom = Fabric(
            str(rng.choice(["plain", "plain", "plaid", "dots"])),
            (denim, tuple(1.8 * c for c in denim), colors[3]),
            float(rng.uniform(0.05, 0.08)),
        )
        iris, shoes = palette(rng, IRISES), palette(rng, CLOTHS)
        betas = tuple(float(b) for b in betas)
        return SyntheticPerson(seed, betas, skin, hair, iris, top, bottom, shoes, outfit)


def _draw_outfit(rng: Generator) -> Outfit:
    sleeve = float(rng.choice([rng.uniform(0.45, 0.75), rng.uniform(1.6, 1.9)]))
    hem, loose = float(rng.uniform(0.08, 0.17)), float(rng.uniform(0.012, 0.026))
    bottom = str(rng.choice(["trousers", "trousers", "shorts", "skirt"]))
    length, flare = {
        "trousers": (rng.uniform(1.85, 1.95), rng.uniform(0.008, 0.022)),
        "shorts": (rng.uniform(0.7, 0.9), rng.uniform(0.008, 0.022)),
        "skirt": (rng.uniform(0.7, 1.0), rng.uniform(0.15, 0.3)),
    }[bottom]
    hair, thick = str(rng.choice(["bob", "bob", "long", "short"])), float(rng.uniform(0.012, 0.02))
    rng.random(2)  # unused; without them, the colours that follow would change
    # A skirt spreads from the hips and would come through a longer shirt.
    hem = 0.4 * hem if bottom == "skirt" else hem
    return Outfit(sleeve, hem, loose, bottom, float(length), float(flare), hair, thick)


# Outfits of one fabric from top to hem; chosen: what phone videos show with arms at the sides.
ONE_PIECE: Mapping[str, Mapping[str, object]] = {
    "dress": dict(sleeve=0.02, hem=0.03, loose=0.01, bottom="skirt", length=0.9, flare=0.2),
    "coat": dict(sleeve=1.75, hem=0.06, loose=0.034, bottom="skirt", length=1.0, flare=0.14),
}


def foreign_outfit(outfit: Outfit, rng: Generator) -> Outfit:
    """Change an outfit to one unlike the others: thick soles, mostly wide trousers."""
    outfit = replace(outfit, sole=float(rng.uniform(0.01, 0.05)))
    if rng.random() < 0.7:
        length, flare = float(rng.uniform(1.8, 1.95)), float(rng.uniform(0.03, 0.06))
        outfit = replace(outfit, bottom="trousers", length=length, flare=flare)
    return outfit


def _fabric(pattern: str, *colors: tuple[int, int, int], scale: float = 0.06) -> Fabric:
    ground, figure, line = (linear(*colors[min(k, len(colors) - 1)]) for k in range(3))
    return Fabric(pattern, (ground, figure, line), scale)


# Betas: height, weight, leg length, arm length, shoulder width, hip width, chest, belly, muscles,
# size of the head.
NAMED: Mapping[str, SyntheticPerson] = MappingProxyType({
    "amira": SyntheticPerson(  # long hair, stripes
        101, (-0.7, -0.4, 0.3, 0.0, -0.5, 0.7, 0.8, -0.5, -0.4, 0.1),
        SKINS[1], HAIRS[1], IRISES[3],
        _fabric("stripes", (238, 232, 222), (176, 44, 48), (40, 44, 70), scale=0.058),
        _fabric("plain", (58, 78, 118), (90, 110, 150)), linear(236, 232, 226),
        Outfit(
            sleeve=1.75, hem=0.06, loose=0.016, bottom="trousers", length=1.92,
            flare=0.008, hair="long", hair_thick=0.019,
        ),
    ),
    "bruno": SyntheticPerson(  # short hair, plaid
        102, (1.1, 0.5, 0.2, 0.2, 0.9, -0.2, 0.2, 0.4, 0.9, 0.0),
        SKINS[0], HAIRS[2], IRISES[1],
        _fabric("plaid", (52, 104, 84), (24, 38, 48), (226, 178, 70), scale=0.075),
        _fabric("plain", (160, 138, 104), (120, 100, 76)), linear(96, 62, 42),
        Outfit(
            sleeve=0.62, hem=0.16, loose=0.020, bottom="trousers", length=1.93,
            flare=0.014, hair="short", hair_thick=0.014,
        ),
    ),
    "dalia": SyntheticPerson(  # a skirt, hair to the shoulder blades, a top of one colour
        104, (0.3, -0.2, 0.6, 0.1, -0.6, 1.0, 1.0, -0.3, -0.5, 0.0),
        SKINS[0], HAIRS[3], IRISES[2],
        _fabric("smooth", (66, 140, 150)),
        _fabric("dots", (120, 48, 84), (238, 226, 214), (238, 226, 214), scale=0.045),
        linear(60, 60, 68),
        Outfit(
            sleeve=0.55, hem=0.035, loose=0.017, bottom="skirt", length=0.95,
            flare=0.26, hair="long", hair_thick=0.019,
        ),
    ),
    "edgar": SyntheticPerson(  # a heavy body, a white shirt without texture
        105, (0.2, 1.3, -0.2, 0.0, 0.6, 0.4, 0.3, 1.3, 0.2, 0.0),
        SKINS[3], HAIRS[0], IRISES[3],
        _fabric("smooth", (226, 224, 218)),
        _fabric("plain", (92, 104, 84), (60, 70, 54)), linear(46, 48, 58),
        Outfit(
            sleeve=0.70, hem=0.17, loose=0.024, bottom="shorts", length=0.92,
            flare=0.022, hair="short", hair_thick=0.012,
        ),
    ),
})  # fmt: skip
