"""Find a body's arrays in a file, whatever their names and shapes: :func:`find_body`.

=====================  =======================================================================
Ours                   Written by
=====================  =======================================================================
:data:`WHOLE`          all joints in a row: AMASS, AIST++, WHAM, GRAB, InstantAvatar, ROMP
:data:`SPELLINGS`      parts: SMPL-X itself, AMASS, Inter-X, OSX, THuman, most estimators
``Rh``, ``Th``         EasyMocap's turn about the origin, x = R(Rh) b + Th
=====================  =======================================================================

Rotations are axis-angle or matrices, flat or joint by joint. The numbers of a row tell the body:
165 SMPL-X, 156 SMPL+H, 72 SMPL, 66 the 22 joints that all have. The root may be the first joint of
the body's pose. The arrays may lie in a dictionary of their own, such as ``params``.

Fingers may be components of SMPL-X's PCA, c (T, k) with k < 45: they are c C relative to the mean
hand, with the components C of the body's file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gva_mi.body.pose import BODY, JOINTS, LEFT_HAND, RIGHT_HAND, SMPLX_FIELDS
from gva_mi.body.rotations import composed, nearest_rotations, to_matrices, to_rotvecs
from gva_mi.body.smpl import FORMATS, SMPL, SMPLH, SMPLX
from gva_mi.core.errors import InputError
from gva_mi.data.importers.spellings import SPELLINGS, WHOLE, NamedArrays, holds_pose, unnested

SCALES = ("smpl_scaling", "body_scale")  # and "scale" where the translation is "translation"
VPOSER = 32  # numbers of VPoser's latent code
_PARTS = {
    **SMPLX_FIELDS, "hands": slice(LEFT_HAND.start, RIGHT_HAND.stop), "eyes": slice(23, 25),
}  # fmt: skip
_COUNTS = (*FORMATS, BODY.stop)  # joints of a whole body
_FINGERS = 3 * (LEFT_HAND.stop - LEFT_HAND.start)  # numbers of a hand in axis-angle


@dataclass(frozen=True)
class FoundBody:
    """A body's arrays in T frames, in the file's own axes."""

    rotations: np.ndarray  # (T, 55, 3) axis-angle, radians; may hold NaN
    form: str  # "SMPL", "SMPL+H" or "SMPL-X": whose betas they go with
    has_hands: bool
    from_mean_hand: bool  # fingers are relative to the model's mean hand, not to the flat
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
    whole, pose = arrays.take(*WHOLE)
    root, orient = arrays.take("global_orient") if whole is None or _is_body(pose) else (None, None)
    if whole is not None and root is not None:
        arrays["body_pose"] = pose
        whole = None
    elif whole is None and root is None:
        whole, pose = arrays.take("body_pose")
    if whole is not None:
        rotations, form, has_hands = _whole(where, whole, pose)
        from_mean = False
    elif root is not None and arrays.keys() & {*SPELLINGS["body_pose"]}:
        rotations, form, has_hands, from_mean = _of_parts(arrays, root, orient, components)
    else:
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
    turns = None
    if {"Rh", "Th"} <= arrays.keys():
        rotations, turns = _about_origin(arrays, rotations)
    transl = _transl(arrays, len(rotations), "Th" if turns is not None else "transl")
    expression = _rows_of(arrays, "expression", len(rotations))
    return FoundBody(
        rotations, form, has_hands, from_mean, transl, turns, _betas(arrays), expression,
        arrays.unused(),
    )  # fmt: skip


def _is_body(pose: np.ndarray) -> bool:
    """Whether an array named as all joints has those below the root alone."""
    return (int(np.prod(pose.shape[1:])) if pose.ndim > 1 else pose.size) in (
        3 * (BODY.stop - 1),
        3 * (len(SMPL.joints) - 1),
    )


def _about_origin(arrays: NamedArrays, rotations: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turn the roots by EasyMocap's Rh; return the rotations, and its matrices (T, 3, 3)."""
    name, Rh = arrays.take("Rh")
    if Rh.size != 3 * len(rotations):
        raise InputError(f"{arrays.where}: '{name}' must be ({len(rotations)}, 3), got {Rh.shape}")
    rotations, Rh = rotations.copy(), Rh.reshape(-1, 3)
    rotations[:, 0] = composed(Rh, rotations[:, 0])
    return rotations, to_matrices(Rh)


def _transl(arrays: NamedArrays, frames: int, ours: str) -> np.ndarray | None:
    """Return the translation (T, 3), metres, of a body that is not scaled.

    Where a body is scaled by s, as in AIST++ and THuman, all is divided by s: x = s b + t looks
    the same as b + t / s.
    """
    name, transl = arrays.take(ours)
    if name is None:
        return None
    if transl.size != 3 * frames:
        raise InputError(f"{arrays.where}: '{name}' must be ({frames}, 3), got {transl.shape}")
    key, scaling = arrays.take(*SCALES, *(["scale"] if name == "translation" else []))
    if key is None:
        return transl.reshape(frames, 3)
    scaling = scaling.ravel()
    if scaling.size not in (1, frames) or not ((scaling > 0) & (scaling < np.inf)).all():
        raise InputError(f"{arrays.where}: '{key}' must be one number above 0, got {scaling}")
    return transl.reshape(frames, 3) / scaling[:, None]


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


def _rows_of(arrays: NamedArrays, ours: str, frames: int) -> np.ndarray | None:
    """Return rows of numbers (T, n); one row is every frame's."""
    name, x = arrays.take(ours)
    if name is None or not x.size:
        return None
    rows = x.reshape(1, -1) if x.size == x.shape[-1] else x.reshape(len(x), -1)
    if len(rows) not in (1, frames):
        raise InputError(f"{arrays.where}: '{name}' must be ({frames}, n), got {x.shape}")
    return np.broadcast_to(rows, (frames, rows.shape[1]))


def _whole(where: str, name: str, pose: np.ndarray) -> tuple[np.ndarray, str, bool]:
    """Return rotations (T, 55, 3), form, and whether it has hands, of all joints in a row."""
    if not pose.size:
        raise InputError(f"{where}: '{name}' must be numbers (T, 3 J), got {pose.shape}")
    rows = pose[None] if pose.ndim == 1 else pose
    numbers = rows[0].size
    of = {3 * n: n for n in _COUNTS} | {9 * n: n for n in _COUNTS}
    if numbers not in of or (rows.ndim > 2 and rows.shape[-1] != 3):
        raise InputError(
            f"{where}: '{name}' has {numbers} numbers a frame; expected 165 (SMPL-X), "
            f"156 (SMPL+H), 72 (SMPL) or 66 (its 22 joints above the hands); got {pose.shape}"
        )
    angles = axis_angles(where, name, rows, len(rows), of[numbers])
    rotations = np.zeros((len(angles), len(JOINTS), 3))
    form = FORMATS.get(of[numbers], SMPL)
    joints = list(range(BODY.stop)) if form is SMPL else list(form.joints)  # without mittens
    rotations[:, joints] = angles[:, : len(joints)]
    return rotations, form.name, form is not SMPL


def axis_angles(where: str, name: str, x: np.ndarray, frames: int, joints: int) -> np.ndarray:
    """Convert T frames of so many joints, of any shape, to axis-angle (T, J, 3)."""
    if x.size == 3 * joints:  # of all frames
        x = np.broadcast_to(x.reshape(1, joints, 3), (frames, joints, 3))
    if x.size == 3 * frames * joints:
        return x.reshape(frames, joints, 3)
    if x.size != 9 * frames * joints:
        hint = ", axis-angle; components of a PCA need the body that they belong to"
        raise InputError(
            f"{where}: '{name}' must be ({frames}, {3 * joints}){hint if 'hand' in name else ''}; "
            f"got {x.shape}"
        )
    matrices = x.reshape(frames, joints, 3, 3)
    known = np.isfinite(matrices).all((-1, -2), keepdims=True)
    matrices = np.where(known, matrices, np.eye(3))
    product = matrices @ matrices.swapaxes(-1, -2)  # orthogonal to a few digits
    if np.abs(product - np.eye(3)).max() > 0.1 or (np.linalg.det(matrices) < 0).any():
        raise InputError(f"{where}: '{name}' {x.shape} must hold rotation matrices")
    return np.where(known[..., 0], to_rotvecs(nearest_rotations(matrices)), np.nan)


def _of_parts(
    arrays: NamedArrays, root: str, orient: np.ndarray, components: np.ndarray | None
) -> tuple[np.ndarray, str, bool, bool]:
    """Return rotations (T, 55, 3), form, whether it has hands, and whether from the mean hand."""
    where, matrix = arrays.where, orient.ndim > 2 and orient.shape[-2:] == (3, 3)
    frames = orient.size // (9 if matrix else 3)
    if not frames or orient.shape[-1] != 3:
        raise InputError(f"{where}: '{root}' must be (T, 3) or (T, 3, 3), got {orient.shape}")
    rotations, form, names = np.zeros((frames, len(JOINTS), 3)), SMPLX.name, {}
    rotations[:, :1] = axis_angles(where, root, orient, frames, 1)
    name, body = arrays.take("body_pose")
    numbers = body.size / frames
    if body.shape[-1] == VPOSER:
        raise InputError(
            f"{where}: '{name}' holds {VPOSER} numbers a frame, a latent code of VPoser, "
            "which only its network decodes; save the decoded body_pose of 63 numbers instead"
        )
    # SMPL's have mittens; some repeat the root.
    count = next((n for n in (21, 23, 22, 24) if numbers in (3 * n, 9 * n)), 21)
    angles = axis_angles(where, name, body, frames, count)
    rotations[:, BODY] = angles[:, count in (22, 24) :][:, :21]
    form = SMPL.name if count in (23, 24) else form
    from_mean = False
    for ours in [key for key in _PARTS if key not in ("global_orient", "body_pose")]:
        part = _PARTS[ours]
        name, x = arrays.take(ours)
        if name is None:
            continue
        names[ours] = name
        weights = x.size // frames
        if (
            ours in ("left_hand_pose", "right_hand_pose")
            and x.size
            and weights < _FINGERS
            and (x.ndim == 2 and len(x) == frames)
        ):
            side = int(ours == "right_hand_pose")
            x, from_mean = _fingers(where, name, x, components, side), True
        rotations[:, part] = axis_angles(where, name, x, frames, part.stop - part.start)
    if form == SMPLX.name and names.get("hands") == "pose_hand" and "jaw_pose" not in names:
        form = SMPLH.name  # AMASS's
    return rotations, form, any("hand" in ours for ours in names), from_mean


def _fingers(
    where: str, name: str, weights: np.ndarray, components: np.ndarray | None, side: int
) -> np.ndarray:
    """Convert components of a hand's PCA (T, k) to axis-angle (T, 45) from the mean hand."""
    if components is None or weights.shape[1] > components.shape[1]:
        raise InputError(
            f"{where}: '{name}' must be (T, {_FINGERS}), axis-angle; components of a PCA "
            "need the body that they belong to: --body with the SMPL-X file whose "
            f"hands_components they weigh; got {weights.shape}"
        )
    return weights @ components[side, : weights.shape[1]]
