"""Families of noise: a family is a distribution over what goes wrong, and how far.

A method that is tuned on one noise learns how its generator errs. So there are several, and each
draws its parameters from a seed: ``bursts`` is the usual one and always the same; the others draw
everything that their name does not settle.

============  ====================================================================================
``bursts``    errors that last some frames and come over a limb at a time; hands that are lost
``white``     independent from frame to frame
``slow``      persisting over 15 to 20 frames
``mixed``     any memory, any share of white noise, any sizes
``lean``      legs, trunk and arms lean toward the camera in every frame, legs by 2 to 6 degrees
``shape``     a person taken for taller or shorter, and put farther or nearer
``outliers``  swapped legs, lost hands, jumps, and frames of which nothing is right
``focal``     a focal length that is 4 to 10 % off, and depth with it
``masks``     masks that lose feet, take in a bag, and are too wide or too narrow
``normals``   normals that are flat, turned, blurred, in another convention, or missing
``anything``  all of it at once, each by chance
============  ====================================================================================
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from gva_mi.data.synthetic.noise.camera_bias import Lean
from gva_mi.data.synthetic.noise.masks import MaskNoise
from gva_mi.data.synthetic.noise.normals import NormalNoise
from gva_mi.data.synthetic.noise.outliers import Outliers
from gva_mi.data.synthetic.noise.poses import JointFactors, PoseNoise
from gva_mi.errors import InputError

Draw = np.random.Generator


@dataclass(frozen=True)
class Noise:
    """What goes wrong in one recording."""

    pose: PoseNoise = PoseNoise()
    mask: MaskNoise = MaskNoise()
    normal: NormalNoise = NormalNoise()


@dataclass(frozen=True)
class Levels:
    """Factors on the noise of a recording; 1 is as drawn, 0 is exact."""

    pose: float = 1.0
    mask: float = 1.0
    normal: float = 1.0


@dataclass(frozen=True)
class Family:
    """A distribution over noises.

    Attributes:
        name: of the family.
        noise: of random numbers, the parameters.
        exact: pictures are degraded as they were rendered, and not as files hold them, in 8 bits
            a channel; so they can be drawn again only from a rendering.
    """

    name: str
    noise: Callable[[Draw], Noise]
    exact: bool = False


def draw(family: str, seed: int) -> Noise:
    """The noise of a recording.

    Args:
        family: one of FAMILIES.
        seed: another seed is another noise of the same family; of ``bursts`` there is one.

    Raises:
        InputError: there is no such family.
    """
    require_family(family)
    return FAMILIES[family].noise(np.random.default_rng((seed, zlib.crc32(family.encode()))))


def require_family(name: str) -> None:
    """Raise an InputError that lists the families if this is none of them."""
    if name not in FAMILIES:
        raise InputError(f"synth: no family '{name}' of noise; there are: {', '.join(FAMILIES)}")


def _mixed_poses(rng: Draw) -> PoseNoise:
    """Errors of any memory and any sizes; nothing else goes wrong."""
    part = lambda: float(rng.lognormal(0, 0.3))
    calm = rng.uniform(0.6, 1.0)
    return PoseNoise(
        sizes=JointFactors(part(), part(), part(), part(), part()),
        memory=float(np.exp(rng.uniform(0, np.log(20)))),
        white=rng.uniform(0, 1),
        calm=calm,
        burst=calm * rng.uniform(1, 3),
        sideways=rng.uniform(0, 1.2),
        depth=rng.uniform(0.01, 0.045),
        aside=rng.uniform(0.003, 0.015),
        betas=rng.uniform(0.1, 0.5),
        expression=rng.uniform(0.1, 0.5),
        outliers=Outliers(lost=rng.uniform(0, 0.08)),
    )


def _mixed_masks(rng: Draw) -> MaskNoise:
    """Boundaries that are wrong by any usual amount."""
    return MaskNoise(
        wobble=rng.uniform(0.6, 1.6),
        wobble_length=rng.uniform(8, 24),
        notches=int(rng.integers(1, 8)),
        notch_radius=rng.uniform(2.5, 6),
    )


def _mixed_normals(rng: Draw) -> NormalNoise:
    """Normals that are blurred and turned by any usual amount."""
    return NormalNoise(
        blur=rng.uniform(1.2, 3.5), tilt=rng.uniform(0.07, 0.2), tilt_length=rng.uniform(25, 90)
    )


def _mixed(rng: Draw) -> Noise:
    return Noise(_mixed_poses(rng), _mixed_masks(rng), _mixed_normals(rng))


def _white(rng: Draw) -> Noise:
    noise = _mixed(rng)
    usual, large = (lambda: rng.uniform(0.85, 1.15)), (lambda: rng.uniform(1.3, 1.55))
    sizes = JointFactors(usual(), usual(), large(), usual(), large())
    level = rng.uniform(0.9, 1.0)
    pose = replace(
        noise.pose, white=1.0, sizes=sizes, calm=level, burst=level,
        depth=rng.uniform(0.018, 0.024), sideways=rng.uniform(0, 0.2), betas=rng.uniform(0.1, 0.2),
    )  # fmt: skip
    return replace(noise, pose=pose)


def _slow(rng: Draw) -> Noise:
    noise = _mixed(rng)
    return replace(
        noise, pose=replace(noise.pose, memory=rng.uniform(15, 20), white=rng.uniform(0, 0.05))
    )


def _lean(rng: Draw) -> Noise:
    noise = _mixed(rng)
    return replace(noise, pose=replace(noise.pose, lean=_drawn_lean(rng)))


def _drawn_lean(rng: Draw) -> Lean:
    legs, trunk, arms = np.radians(rng.uniform((2, 0, 0), (6, 3, 4)))
    return Lean(float(legs), float(trunk), float(arms))


def _shape(rng: Draw) -> Noise:
    noise = _mixed(rng)
    pose = replace(noise.pose, betas=rng.uniform(0.2, 0.5), depth_follows=True)
    return replace(noise, pose=pose)


def _outliers(rng: Draw) -> Noise:
    noise = _mixed(rng)
    outliers = Outliers(
        lost=rng.uniform(0.08, 0.25), swapped=rng.uniform(0.03, 0.1),
        whole=rng.uniform(0.03, 0.08), jumps=rng.uniform(0.04, 0.12),
        jump=rng.uniform(0.04, 0.12),
    )  # fmt: skip
    return replace(noise, pose=replace(noise.pose, outliers=outliers))


def _focal(rng: Draw) -> Noise:
    noise = _mixed(rng)
    focal = rng.choice([-1, 1]) * rng.uniform(0.04, 0.1)
    return replace(noise, pose=replace(noise.pose, focal=float(focal)))


def _masks(rng: Draw) -> Noise:
    noise = _mixed(rng)
    mask = replace(
        noise.mask, grown=rng.choice([-1, 1]) * rng.uniform(1, 3),
        lost_feet=rng.uniform(0.1, 0.35), bag=rng.uniform(0.06, 0.13),
    )  # fmt: skip
    return replace(noise, mask=mask)


def _normals(rng: Draw) -> Noise:
    noise = _mixed(rng)
    normal = replace(
        noise.normal, blur=rng.uniform(2, 6), flat=rng.uniform(0.1, 0.4),
        turn=tuple(np.radians(rng.normal(size=3) * 4).tolist()),
        convention=str(rng.choice(["perspective", "icon"])), missing=rng.uniform(0.05, 0.3),
    )  # fmt: skip
    return replace(noise, normal=normal)


def _anything(rng: Draw) -> Noise:
    """Of what each family alone gets wrong, some."""
    noise = _mixed(rng)
    pose, mask, normal = noise.pose, noise.mask, noise.normal
    shape, outliers, focal = (f(rng).pose for f in (_shape, _outliers, _focal))
    masks, normals = _masks(rng).mask, _normals(rng).normal
    lean = _drawn_lean(rng)
    has = rng.random(6) < 0.5
    if has[0]:
        pose = replace(pose, lean=lean)
    if has[1]:
        pose = replace(pose, betas=shape.betas, depth_follows=True)
    if has[2]:
        pose = replace(pose, outliers=outliers.outliers)
    if has[3]:
        pose = replace(pose, focal=focal.focal)
    return Noise(pose, masks if has[4] else mask, normals if has[5] else normal)


FAMILIES: Mapping[str, Family] = {
    family.name: family
    for family in (
        Family("bursts", lambda rng: Noise(), exact=True),
        Family("white", _white),
        Family("slow", _slow),
        Family("mixed", _mixed),
        Family("lean", _lean),
        Family("shape", _shape),
        Family("outliers", _outliers),
        Family("focal", _focal),
        Family("masks", _masks),
        Family("normals", _normals),
        Family("anything", _anything),
    )
}
