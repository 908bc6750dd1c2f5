"""Convert joint rotations from other programs' names and shapes to SMPL-X's 55 joints.

=================================================  ==========================================
Names                                              Written by
=================================================  ==========================================
``poses``, ``pose``, ``fullpose``, ``smpl_poses``  one row a frame: AMASS, AIST++, WHAM, GRAB,
``thetas``, ``smpl_thetas``                        InstantAvatar, ROMP
``root_orient``, ``pose_body``, ``pose_hand``,     AMASS in parts
``pose_jaw``, ``pose_eye``
``global_orient``, ``body_pose``, ...              SMPL-X itself, most estimators
=================================================  ==========================================

Each may be axis-angle, flat (T, 3 J) or (T, J, 3), or rotation matrices (T, J, 3, 3). The numbers
of a row tell the body: 165 SMPL-X, 156 SMPL+H, 72 SMPL, 66 the 22 joints that all have.

Fingers may be components of SMPL-X's PCA, c (T, k) with k < 45: they are c C relative to the mean
hand, with the components C of the body's file.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gva_mi.body.pose import BODY, JOINTS, LEFT_HAND, RIGHT_HAND, SMPLX_FIELDS
from gva_mi.body.rotations import nearest_rotations, to_rotvecs
from gva_mi.body.smpl import FORMATS, SMPL, SMPLH, SMPLX
from gva_mi.core.errors import InputError

WHOLE = ("poses", "pose", "fullpose", "full_pose", "smpl_poses", "thetas", "smpl_thetas")
TRANSLATIONS = ("trans", "transl", "smpl_trans", "translation")
SCALES = ("smpl_scaling", "body_scale")  # and "scale" where the translation is "translation"
AMASS_PARTS = {  # and which of JOINTS each holds
    "root_orient": slice(0, 1), "pose_body": BODY, "pose_jaw": slice(22, 23),
    "pose_eye": slice(23, 25), "pose_hand": slice(LEFT_HAND.start, RIGHT_HAND.stop),
}  # fmt: skip
VPOSER = 32  # numbers of VPoser's latent code
FINGERS = 3 * (LEFT_HAND.stop - LEFT_HAND.start)  # numbers of a hand in axis-angle
_HANDS = ("left_hand_pose", "right_hand_pose")


@dataclass(frozen=True)
class Joints:
    """Joint rotations of a file, in the file's own world."""

    rotations: np.ndarray  # (T, 55, 3) axis-angle, radians; may hold NaN
    form: str  # "SMPL", "SMPL+H" or "SMPL-X": whose betas they go with
    has_hands: bool
    from_mean_hand: bool = False  # fingers are relative to the model's mean hand, not to the flat


def find_joints(
    where: str, found: Mapping[str, Any], components: np.ndarray | None = None
) -> Joints:
    """Find the joints of T frames, whatever their names.

    ``components`` are the body file's PCA of hands (2, K, 45), left before right.
    """
    whole = next((name for name in WHOLE if name in found), None)
    if whole is not None:
        return _whole(where, whole, found[whole])
    if "root_orient" in found and "pose_body" in found:
        return _parts(where, found, AMASS_PARTS)
    if "global_orient" in found and "body_pose" in found:
        fingers = _fingers(where, found, components)
        joints = _parts(where, {**found, **fingers}, SMPLX_FIELDS)
        return replace(joints, from_mean_hand=bool(fingers))
    names = ", ".join(sorted(map(str, found))[:12]) or "nothing"
    raise InputError(
        f"{where}: holds no poses; expected one of {', '.join(WHOLE)}, or root_orient and "
        f"pose_body, or global_orient and body_pose; found: {names}"
    )


def translation_name(found: Mapping[str, Any]) -> str | None:
    """Return the name under which a file holds the translation; None without one."""
    return next((name for name in TRANSLATIONS if found.get(name) is not None), None)


def find_translation(where: str, found: Mapping[str, Any], frames: int) -> np.ndarray:
    """Return the root's translation (T, 3), metres, of a body that is not scaled.

    Where a body is scaled by s, as in AIST++ and THuman, all is divided by s: x = s b + t looks
    the same as b + t / s.
    """
    name = translation_name(found)
    if name is None:
        return np.zeros((frames, 3))
    transl = _numbers(where, name, found[name])
    if transl.size != 3 * frames:
        raise InputError(f"{where}: '{name}' must be ({frames}, 3), got {transl.shape}")
    scales = (*SCALES, "scale") if name == "translation" else SCALES
    key = next((key for key in scales if found.get(key) is not None), SCALES[0])
    scaling = _numbers(where, key, found.get(key, 1.0)).ravel()
    if scaling.size not in (1, frames) or not ((scaling > 0) & (scaling < np.inf)).all():
        raise InputError(f"{where}: '{key}' must be one number above 0, got {scaling}")
    return transl.reshape(frames, 3) / scaling[:, None]


def find_betas(where: str, found: Mapping[str, Any]) -> np.ndarray | None:
    """Return the person's betas (B,), or (T, B) if they differ between frames; None without."""
    if found.get("betas") is None:
        return None
    given = betas = _numbers(where, "betas", found["betas"])
    if betas.size:
        one = betas.size == betas.shape[-1]
        betas = betas.reshape(betas.shape[-1]) if one else np.squeeze(betas)
    if not betas.size or betas.ndim not in (1, 2) or not np.isfinite(betas).all():
        raise InputError(f"{where}: 'betas' must be finite (B,) or (T, B), got {given.shape}")
    return betas


def axis_angles(where: str, name: str, value: Any) -> np.ndarray:  # noqa: ANN401
    """Convert rotations of any shape in the module's docstring to (T, J, 3) float64 axis-angle."""
    array = _numbers(where, name, value)
    if array.ndim < 2 or array.size == 0:
        raise InputError(f"{where}: '{name}' must be numbers (T, 3 J), got {array.shape}")
    if array.shape[-2:] == (3, 3) and array.ndim in (3, 4):
        return _of_matrices(where, name, array.reshape(len(array), -1, 3, 3))
    if array.ndim > 3 or (array.ndim == 3 and array.shape[2] != 3) or array[0].size % 3:
        raise InputError(
            f"{where}: '{name}' must be (T, 3 J), (T, J, 3) or (T, J, 3, 3), got {array.shape}"
        )
    return array.reshape(len(array), -1, 3)


def _of_matrices(where: str, name: str, matrices: np.ndarray) -> np.ndarray:
    """Convert matrices that are orthogonal to a few digits to axis-angle (T, J, 3)."""
    known = np.isfinite(matrices).all((-1, -2), keepdims=True)
    matrices = np.where(known, matrices, np.eye(3))
    product = matrices @ matrices.swapaxes(-1, -2)
    if np.abs(product - np.eye(3)).max() > 0.1 or (np.linalg.det(matrices) < 0).any():
        raise InputError(f"{where}: '{name}' {matrices.shape} must hold rotation matrices")
    return np.where(known[..., 0], to_rotvecs(nearest_rotations(matrices)), np.nan)


def _whole(where: str, name: str, value: Any) -> Joints:  # noqa: ANN401
    angles = axis_angles(where, name, value)
    count = angles.shape[1]
    if count not in (*FORMATS, BODY.stop):
        raise InputError(
            f"{where}: '{name}' has {3 * count} numbers a frame; expected 165 (SMPL-X), "
            "156 (SMPL+H), 72 (SMPL) or 66 (its 22 joints above the hands)"
        )
    rotations = np.zeros((len(angles), len(JOINTS), 3))
    form = FORMATS.get(count, SMPL)
    joints = list(range(BODY.stop)) if form is SMPL else list(form.joints)  # without mittens
    rotations[:, joints] = angles[:, : len(joints)]
    return Joints(rotations, form.name, form is not SMPL)


def _fingers(
    where: str, found: Mapping[str, Any], components: np.ndarray | None
) -> dict[str, np.ndarray]:
    """Convert hands given as PCA components (T, k) to axis-angle (T, 45), by their names."""
    fingers, rows = {}, np.shape(found["body_pose"])[:1]
    for side, name in enumerate(_HANDS):
        shape = np.shape(found.get(name))
        if len(shape) != 2 or shape[:1] != rows or not 0 < shape[1] < FINGERS:
            continue
        if components is None or shape[1] > components.shape[1]:
            raise InputError(
                f"{where}: '{name}' must be (T, {FINGERS}), axis-angle; components of a PCA "
                "need the body that they belong to: --body with the SMPL-X file whose "
                f"hands_components they weigh; got {shape}"
            )
        fingers[name] = _numbers(where, name, found[name]) @ components[side, : shape[1]]
    return fingers


def _parts(where: str, found: Mapping[str, Any], parts: Mapping[str, slice]) -> Joints:
    body_name = "pose_body" if "pose_body" in parts else "body_pose"
    shape = np.shape(found[body_name])
    if shape and shape[-1] == VPOSER:
        raise InputError(
            f"{where}: '{body_name}' holds {VPOSER} numbers a frame, a latent code of VPoser, "
            "which only its network decodes; save the decoded body_pose of 63 numbers instead"
        )
    rotations, form, has_hands = None, SMPLX.name, False
    for name, part in parts.items():
        if found.get(name) is None:
            continue
        angles = axis_angles(where, name, found[name])
        if rotations is None:
            rotations = np.zeros((len(angles), len(JOINTS), 3))
        wanted = part.stop - part.start
        if name == body_name and angles.shape[1] in (23, 24):  # SMPL's; 24 repeat the root
            angles, form = angles[:, -23:-2], SMPL.name
        if angles.shape != (len(rotations), wanted, 3):
            hint = ""
            if "hand" in name:
                hint = ", axis-angle; components of a PCA need the body that they belong to"
            raise InputError(
                f"{where}: '{name}' must be ({len(rotations)}, {3 * wanted}){hint}; "
                f"got {np.shape(found[name])}"
            )
        has_hands |= "hand" in name
        rotations[:, part] = angles
    if form == SMPLX.name and "pose_jaw" not in found and "pose_hand" in found:
        form = SMPLH.name
    return Joints(rotations, form, has_hands)


def _numbers(where: str, name: str, value: Any) -> np.ndarray:  # noqa: ANN401
    """Convert an array of numbers to float64, with at least one dimension."""
    try:
        return np.atleast_1d(np.asarray(value, np.float64))
    except (ValueError, TypeError):
        raise InputError(f"{where}: '{name}' must be numbers, got {value!s:.40}") from None
