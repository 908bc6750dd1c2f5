"""Error models: distributions over what a pipeline gets wrong, and by how much.

A method tuned on one error model learns how its generator errs, so there are several. ``bursts`` is
the default and always the same; the others draw all parameters from a seed.

============  ====================================================================================
``none``      exact estimates
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
from itertools import compress

import numpy as np
from numpy.random import Generator

from gva_mi.synthetic.errors.masks_and_normals import MaskErrors, NormalErrors
from gva_mi.synthetic.errors.poses import CameraTilt, JointFactors, Outliers, PoseErrors

NO_ERRORS, BURSTS = "none", "bursts"  # these degrade rendered pictures, others the 8-bit files


@dataclass(frozen=True)
class ErrorParameters:
    """The errors of one video's estimates."""

    pose: PoseErrors = PoseErrors()
    mask: MaskErrors = MaskErrors()
    normal: NormalErrors = NormalErrors()


def draw_errors(error_model: str, seed: int) -> ErrorParameters | None:
    """Draw the errors of a video's estimates from one of ERROR_MODELS; None for NO_ERRORS."""
    if error_model == NO_ERRORS:
        return None
    rng = np.random.default_rng((seed, zlib.crc32(error_model.encode())))
    return ERROR_MODELS[error_model](rng)


def _mixed(rng: Generator) -> ErrorParameters:
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


def _changed(errors: ErrorParameters, part: str, **changes: object) -> ErrorParameters:
    return replace(errors, **{part: replace(getattr(errors, part), **changes)})


def _white(rng: Generator) -> ErrorParameters:
    errors = _mixed(rng)
    usual, large = (lambda: rng.uniform(0.85, 1.15)), (lambda: rng.uniform(1.3, 1.55))
    sizes = JointFactors(usual(), usual(), large(), usual(), large())
    level = rng.uniform(0.9, 1.0)
    return _changed(
        errors, "pose", white=1.0, sizes=sizes, calm=level, burst=level,
        depth=rng.uniform(0.018, 0.024), sideways=rng.uniform(0, 0.2), betas=rng.uniform(0.1, 0.2),
    )  # fmt: skip


def _draw_lean(rng: Generator) -> CameraTilt:
    legs, trunk, arms = np.radians(rng.uniform((2, 0, 0), (6, 3, 4)))
    return CameraTilt(float(legs), float(trunk), float(arms))


def _outliers(rng: Generator) -> ErrorParameters:
    errors = _mixed(rng)
    outliers = Outliers(
        lost=rng.uniform(0.08, 0.25), swapped=rng.uniform(0.03, 0.1),
        whole=rng.uniform(0.03, 0.08), jumps=rng.uniform(0.04, 0.12),
        jump=rng.uniform(0.04, 0.12),
    )  # fmt: skip
    return _changed(errors, "pose", outliers=outliers)


def _masks(rng: Generator) -> ErrorParameters:
    return _changed(
        _mixed(rng), "mask", grown=rng.choice([-1, 1]) * rng.uniform(1, 3),
        lost_feet=rng.uniform(0.1, 0.35), bag=rng.uniform(0.06, 0.13),
    )  # fmt: skip


def _normals(rng: Generator) -> ErrorParameters:
    return _changed(
        _mixed(rng), "normal", blur=rng.uniform(2, 6), flat=rng.uniform(0.1, 0.4),
        turn=tuple(np.radians(rng.normal(size=3) * 4).tolist()),
        convention=str(rng.choice(["perspective", "icon"])), missing=rng.uniform(0.05, 0.3),
    )  # fmt: skip


def _anything(rng: Generator) -> ErrorParameters:
    errors, parts = _mixed(rng), ("shape", "outliers", "focal", "masks", "normals")
    shape, outliers, focal, masks, normals = (ERROR_MODELS[part](rng) for part in parts)
    lean, has = _draw_lean(rng), rng.random(6) < 0.5
    changes = (
        {"lean": lean}, {"betas": shape.pose.betas, "depth_follows": True},
        {"outliers": outliers.pose.outliers}, {"focal": focal.pose.focal},
    )  # fmt: skip
    for change in compress(changes, has):
        errors = _changed(errors, "pose", **change)
    mask, normal = (masks if has[4] else errors).mask, (normals if has[5] else errors).normal
    return ErrorParameters(errors.pose, mask, normal)


ERROR_MODELS: Mapping[str, Callable[[Generator], ErrorParameters]] = {
    BURSTS: lambda rng: ErrorParameters(),
    "white": _white,
    "slow": lambda rng: _changed(_mixed(rng), "pose", memory=rng.uniform(15, 20),
                                 white=rng.uniform(0, 0.05)),
    "mixed": _mixed,
    "lean": lambda rng: _changed(_mixed(rng), "pose", lean=_draw_lean(rng)),
    "shape": lambda rng: _changed(_mixed(rng), "pose", betas=rng.uniform(0.2, 0.5),
                                  depth_follows=True),
    "outliers": _outliers,
    "focal": lambda rng: _changed(_mixed(rng), "pose",
                                  focal=float(rng.choice([-1, 1]) * rng.uniform(0.04, 0.1))),
    "masks": _masks, "normals": _normals, "anything": _anything,
}  # fmt: skip
