"""Error models: distributions over what a pipeline gets wrong, and by how much.

A method tuned on one error model learns how its generator errs, so there are several. ``bursts`` is
the default and always the same; the others draw all parameters from a seed.

============  ====================================================================================
``bursts``    errors that last some frames, on one limb at a time; lost hands
``white``     independent from frame to frame
``slow``      persisting over 15 to 20 frames
``mixed``     any persistence, any fraction of white noise, any sizes
``lean``      legs, trunk and arms tilt toward the camera in every frame, legs by 2 to 6 degrees
``shape``     the person is estimated taller or shorter, and placed farther or nearer
``outliers``  swapped legs, lost hands, jumps, and frames with large errors of all joints
``focal``     the focal length is 4 to 10 % off, and depth with it
``masks``     masks without feet, with a bag, and too wide or too narrow
``normals``   flattened, turned, blurred, in another convention, or missing
``anything``  each of these with probability one half
============  ====================================================================================
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from gva_mi.core.errors import InputError
from gva_mi.synthetic.error_models.camera_bias import CameraTilt
from gva_mi.synthetic.error_models.masks import MaskErrors
from gva_mi.synthetic.error_models.normals import NormalErrors
from gva_mi.synthetic.error_models.outliers import Outliers
from gva_mi.synthetic.error_models.poses import JointFactors, PoseErrors

EXACT = "bursts"  # degrades pictures as rendered, the others the 8-bit files of the ground truth


@dataclass(frozen=True)
class ErrorParameters:
    """The errors of one recording."""

    pose: PoseErrors = PoseErrors()
    mask: MaskErrors = MaskErrors()
    normal: NormalErrors = NormalErrors()


@dataclass(frozen=True)
class Levels:
    """Factors on the errors of a recording; 1 is as drawn, 0 is exact."""

    pose: float = 1.0
    mask: float = 1.0
    normal: float = 1.0


ErrorModel = Callable[[np.random.Generator], ErrorParameters]


def draw_errors(family: str, seed: int) -> ErrorParameters:
    """Draw the errors of a recording from one of ERROR_MODELS."""
    return ERROR_MODELS[family](np.random.default_rng((seed, zlib.crc32(family.encode()))))


def require_family(name: str) -> None:
    """Raise an InputError with the known error models if this is none of them."""
    if name not in ERROR_MODELS:
        raise InputError(
            f"synth: no family '{name}' of noise; there are: {', '.join(ERROR_MODELS)}"
        )


def _mixed(rng: np.random.Generator) -> ErrorParameters:
    """Draw errors of any persistence and any size, without bias or further outliers."""
    part = lambda: float(rng.lognormal(0, 0.3))
    calm = rng.uniform(0.6, 1.0)
    pose = PoseErrors(
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
    mask = MaskErrors(
        wobble=rng.uniform(0.6, 1.6), wobble_length=rng.uniform(8, 24),
        notches=int(rng.integers(1, 8)), notch_radius=rng.uniform(2.5, 6),
    )  # fmt: skip
    normal = NormalErrors(
        blur=rng.uniform(1.2, 3.5), tilt=rng.uniform(0.07, 0.2), tilt_length=rng.uniform(25, 90)
    )
    return ErrorParameters(pose, mask, normal)


def _with_pose(errors: ErrorParameters, **changes: object) -> ErrorParameters:
    return replace(errors, pose=replace(errors.pose, **changes))


def _white(rng: np.random.Generator) -> ErrorParameters:
    errors = _mixed(rng)
    usual, large = (lambda: rng.uniform(0.85, 1.15)), (lambda: rng.uniform(1.3, 1.55))
    sizes = JointFactors(usual(), usual(), large(), usual(), large())
    level = rng.uniform(0.9, 1.0)
    return _with_pose(
        errors, white=1.0, sizes=sizes, calm=level, burst=level,
        depth=rng.uniform(0.018, 0.024), sideways=rng.uniform(0, 0.2), betas=rng.uniform(0.1, 0.2),
    )  # fmt: skip


def _draw_lean(rng: np.random.Generator) -> CameraTilt:
    legs, trunk, arms = np.radians(rng.uniform((2, 0, 0), (6, 3, 4)))
    return CameraTilt(float(legs), float(trunk), float(arms))


def _shape(rng: np.random.Generator) -> ErrorParameters:
    return _with_pose(_mixed(rng), betas=rng.uniform(0.2, 0.5), depth_follows=True)


def _outliers(rng: np.random.Generator) -> ErrorParameters:
    errors = _mixed(rng)
    outliers = Outliers(
        lost=rng.uniform(0.08, 0.25), swapped=rng.uniform(0.03, 0.1),
        whole=rng.uniform(0.03, 0.08), jumps=rng.uniform(0.04, 0.12),
        jump=rng.uniform(0.04, 0.12),
    )  # fmt: skip
    return _with_pose(errors, outliers=outliers)


def _focal(rng: np.random.Generator) -> ErrorParameters:
    errors = _mixed(rng)
    return _with_pose(errors, focal=float(rng.choice([-1, 1]) * rng.uniform(0.04, 0.1)))


def _masks(rng: np.random.Generator) -> ErrorParameters:
    errors = _mixed(rng)
    mask = replace(
        errors.mask, grown=rng.choice([-1, 1]) * rng.uniform(1, 3),
        lost_feet=rng.uniform(0.1, 0.35), bag=rng.uniform(0.06, 0.13),
    )  # fmt: skip
    return replace(errors, mask=mask)


def _normals(rng: np.random.Generator) -> ErrorParameters:
    errors = _mixed(rng)
    normal = replace(
        errors.normal, blur=rng.uniform(2, 6), flat=rng.uniform(0.1, 0.4),
        turn=tuple(np.radians(rng.normal(size=3) * 4).tolist()),
        convention=str(rng.choice(["perspective", "icon"])), missing=rng.uniform(0.05, 0.3),
    )  # fmt: skip
    return replace(errors, normal=normal)


def _anything(rng: np.random.Generator) -> ErrorParameters:
    errors = _mixed(rng)
    shape, outliers, focal = (f(rng).pose for f in (_shape, _outliers, _focal))
    masks, normals = _masks(rng).mask, _normals(rng).normal
    lean = _draw_lean(rng)
    has = rng.random(6) < 0.5
    if has[0]:
        errors = _with_pose(errors, lean=lean)
    if has[1]:
        errors = _with_pose(errors, betas=shape.betas, depth_follows=True)
    if has[2]:
        errors = _with_pose(errors, outliers=outliers.outliers)
    if has[3]:
        errors = _with_pose(errors, focal=focal.focal)
    return ErrorParameters(
        errors.pose, masks if has[4] else errors.mask, normals if has[5] else errors.normal
    )


ERROR_MODELS: Mapping[str, ErrorModel] = {
    EXACT: lambda rng: ErrorParameters(),
    "white": _white,
    "slow": lambda rng: _with_pose(
        _mixed(rng), memory=rng.uniform(15, 20), white=rng.uniform(0, 0.05)
    ),
    "mixed": _mixed,
    "lean": lambda rng: _with_pose(_mixed(rng), lean=_draw_lean(rng)),
    "shape": _shape, "outliers": _outliers, "focal": _focal, "masks": _masks,
    "normals": _normals, "anything": _anything,
}  # fmt: skip
