"""Find a body's arrays in a file, whatever their names and shapes: :func:`find_body`.

=====================  =======================================================================
Ours                   Written by
=====================  =======================================================================
:data:`WHOLE`          all joints in a row: AMASS, AIST++, WHAM, GRAB, InstantAvatar, ROMP
:data:`SPELLINGS`      parts: SMPL-X itself, AMASS, Inter-X, OSX, THuman, most estimators
``Rh``, ``Th``         EasyMocap's turn about the origin, x = R(Rh) b + Th
=====================  =======================================================================

The arrays may lie in a dictionary of their own, such as ``params``; shapes of rotations are those
of :mod:`.joint_rotations`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gva_mi.body.rotations import composed, to_matrices
from gva_mi.core.errors import InputError
from gva_mi.data.importers.joint_rotations import JointRotations, by_frame, find_rotations
from gva_mi.data.importers.spellings import WHOLE, NamedArrays, holds_pose, unnested

SCALES = ("smpl_scaling", "body_scale")  # and "scale" where the translation is "translation"


@dataclass(frozen=True)
class FoundBody:
    """A body's arrays in T frames, in the file's own axes."""

    joints: JointRotations
    transl: np.ndarray | None  # (T, 3) metres, of a body that is not scaled; None: there is none
    about_origin: np.ndarray | None  # (T, 3, 3) turns, where the body turns about the origin
    betas: np.ndarray | None  # (B,), or (n, B) if they differ between frames
    expression: np.ndarray | None  # (T, E)
    unused: tuple[str, ...]  # names of the other arrays of numbers


def find_body(
    where: str, found: Mapping[str, Any], components: np.ndarray | None = None
) -> FoundBody:
    """Find the joints, the place and the shape of T frames.

    ``components`` are the body file's PCA of hands (2, K, 45), left before right.
    """
    arrays = NamedArrays(where, unnested(found))
    joints = find_rotations(arrays, components)
    if joints is None:
        names = ", ".join(sorted(map(str, found))[:12]) or "nothing"
        if len(several := [str(name) for name, x in found.items() if holds_pose(x)]) > 1:
            raise InputError(
                f"{where}: holds poses in several dictionaries, {', '.join(several[:6])}; save one "
                "of them alone"
            )
        raise InputError(
            f"{where}: holds no poses; expected one of {', '.join(WHOLE)}, or root_orient and "
            f"pose_body, or global_orient and body_pose; found: {names}"
        )
    turns, frames = None, len(joints.rotations)
    if {"Rh", "Th"} <= arrays.keys():
        Rh = _vectors(where, *arrays.take("Rh"), frames)
        joints.rotations[:, 0] = composed(Rh, joints.rotations[:, 0])
        turns = to_matrices(Rh)
    transl = _transl(arrays, frames, "Th" if turns is not None else "transl")
    name, face = arrays.take("expression")
    if name is None or not face.size:
        face = None
    else:
        rows = face.reshape(1 if face.size == face.shape[-1] else len(face), -1)
        if len(rows) not in (1, frames):  # one row is every frame's
            raise InputError(f"{where}: '{name}' must be ({frames}, n), got {face.shape}")
        face = np.broadcast_to(rows, (frames, rows.shape[1]))
    return FoundBody(joints, transl, turns, _betas(arrays), face, arrays.unused())


def _vectors(where: str, name: str, x: np.ndarray, frames: int) -> np.ndarray:
    """Return an array of vectors as (T, 3), or refuse it."""
    rows = by_frame(x, frames, 3)
    if rows is None:
        raise InputError(f"{where}: '{name}' must be ({frames}, 3), got {x.shape}")
    return rows


def _transl(arrays: NamedArrays, frames: int, ours: str) -> np.ndarray | None:
    """Return the translation (T, 3), metres, of a body that is not scaled.

    Where a body is scaled by s, as in AIST++ and THuman, all is divided by s: x = s b + t looks
    the same as b + t / s.
    """
    name, transl = arrays.take(ours)
    if name is None:
        return None
    transl = _vectors(arrays.where, name, transl, frames)
    key, scaling = arrays.take(*SCALES, *(["scale"] if name == "translation" else []))
    if key is None:
        return transl
    scaling = scaling.ravel()
    if scaling.size not in (1, frames) or not ((scaling > 0) & (scaling < np.inf)).all():
        raise InputError(f"{arrays.where}: '{key}' must be one number above 0, got {scaling}")
    return transl / scaling[:, None]


def _betas(arrays: NamedArrays) -> np.ndarray | None:
    name, betas = arrays.take("betas")
    if name is None:
        return None
    given = betas.shape
    if betas.size:
        one = betas.size == betas.shape[-1]
        betas = betas.reshape(betas.shape[-1]) if one else np.squeeze(betas)
    if not betas.size or betas.ndim not in (1, 2) or not np.isfinite(betas).all():
        raise InputError(f"{arrays.where}: '{name}' must be finite (B,) or (T, B), got {given}")
    return betas
