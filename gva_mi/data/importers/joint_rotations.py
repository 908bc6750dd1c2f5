"""Convert the rotations of a body's joints, in any public shape, to axis-angle of 55 joints.

They are axis-angle or matrices, flat or joint by joint. The numbers of a row tell the body: 165
SMPL-X, 156 SMPL+H, 72 SMPL, 66 the 22 joints that all have, with hands and face beside them or
without. The root may be the first joint of the body's pose.

Fingers may be components of SMPL-X's PCA, c (T, k) with k < 45: they are c C relative to the mean
hand, with the components C of the body's file.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from gva_mi.body.body_file import FORMATS, SMPL, SMPLH, SMPLX
from gva_mi.body.pose import BODY, JOINTS, LEFT_HAND, RIGHT_HAND, SMPLX_FIELDS
from gva_mi.body.rotations import nearest_rotations, to_rotvecs
from gva_mi.core.errors import InputError
from gva_mi.data.importers.spellings import WHOLE, NamedArrays

VPOSER = 32  # numbers of VPoser's latent code
PARTS = {
    **SMPLX_FIELDS, "hands": slice(LEFT_HAND.start, RIGHT_HAND.stop), "eyes": slice(23, 25),
    "face": slice(22, 25),
}  # fmt: skip
_ROOT_AND_BODY = ("global_orient", "body_pose")
_OTHERS = {ours: part for ours, part in PARTS.items() if ours not in _ROOT_AND_BODY}
_COUNTS = (*FORMATS, BODY.stop)  # joints of a whole body
_NUMBERS = {3 * n: n for n in _COUNTS} | {9 * n: n for n in _COUNTS}  # of a row: its joints
_NO_ANGLES = {  # of a row: numbers of other rotations, whose order programs do not agree on
    k * n: words for n in _COUNTS
    for k, words in ((4, "quaternions"), (6, "two columns or rows of matrices (6D)"))
}  # fmt: skip
_BELOW_THE_ROOT = 3 * (BODY.stop - 1), 3 * (len(SMPL.joints) - 1)  # numbers of joints below it
_FINGERS = 3 * (LEFT_HAND.stop - LEFT_HAND.start)  # numbers of a hand in axis-angle
# Some programs add whole turns to a limb's rotation, but not so many; in degrees, arms that hang
# down are turned by more than this.
_TURNS = 4 * 2 * np.pi


@dataclass(frozen=True)
class JointRotations:
    """Rotations of a body's joints in T frames."""

    rotations: np.ndarray  # (T, 55, 3) axis-angle, radians; may hold NaN
    form: str  # "SMPL", "SMPL+H" or "SMPL-X"
    has_hands: bool
    from_mean_hand: bool = False  # fingers are relative to the model's mean hand, not to the flat


def find_rotations(
    arrays: NamedArrays, components: np.ndarray | None = None
) -> JointRotations | None:
    """Find the joints of T frames among named arrays; None if these hold no poses.

    ``components`` are the body file's PCA of hands (2, K, 45), left before right.
    """
    whole, pose = arrays.take(*WHOLE)
    root = orient = None
    if whole is None or math.prod(pose.shape[pose.ndim > 1 :]) in _BELOW_THE_ROOT:
        root, orient = arrays.take("global_orient")
    if whole is not None and root is not None:
        arrays["body_pose"] = pose
        whole = None
    elif whole is None and root is None:
        whole, pose = arrays.take("body_pose")
    form = SMPLX.name  # whose first 22 joints are all bodies', if others lie beside them
    if whole is not None:
        found, count = _whole(arrays.where, whole, pose)
        form = form if count == BODY.stop else found.form
        arrays.cover(*(PARTS if found.has_hands else _ROOT_AND_BODY))
    elif root is not None and arrays.holds("body_pose"):
        found = _root_and_body(arrays, root, orient)
        form = found.form
    else:
        return None
    found = found if found.has_hands else _with_parts(arrays, found, form, components)
    turns = np.nan_to_num(np.linalg.norm(found.rotations[:, 1:], axis=2))
    if (largest := float(np.median(turns, axis=0).max())) > _TURNS:
        raise InputError(
            f"{arrays.where}: a limb is turned by {largest:.0f} radians in most frames, such as by "
            "rotations in degrees; expected axis-angle in radians"
        )
    return found


def _whole(where: str, name: str, pose: np.ndarray) -> tuple[JointRotations, int]:
    """Return the joints of a pose with all of them in a row, (T, 3 J), and their number."""
    if not pose.size:
        raise InputError(f"{where}: '{name}' must be numbers (T, 3 J), got {pose.shape}")
    rows = pose[None] if pose.ndim == 1 else pose
    if rows.ndim > 2 and len(rows) == 1 and rows[0].size not in _NUMBERS:
        rows = rows[0]  # a batch of one motion
    numbers, axes = rows[0].size, [n for n in rows.shape[1:] if n > 1]
    if numbers not in _NUMBERS or (len(axes) > 1 and axes[-1] != 3):
        other = f", such as {_NO_ANGLES[numbers]}" if numbers in _NO_ANGLES else ""
        raise InputError(
            f"{where}: '{name}' has {numbers} numbers a frame{other}; expected axis-angle, 165 "
            f"(SMPL-X), 156 (SMPL+H), 72 (SMPL) or 66 (its 22 joints above the hands), or "
            f"matrices; got {pose.shape}"
        )
    count = _NUMBERS[numbers]
    angles = axis_angles(where, name, rows, len(rows), count)
    rotations = np.zeros((len(angles), len(JOINTS), 3))
    form = FORMATS.get(count, SMPL)
    joints = list(range(BODY.stop)) if form is SMPL else list(form.joints)  # without mittens
    rotations[:, joints] = angles[:, : len(joints)]
    return JointRotations(rotations, form.name, form is not SMPL), count


def axis_angles(where: str, name: str, x: np.ndarray, frames: int, joints: int) -> np.ndarray:
    """Convert T frames of so many joints, of any shape, to axis-angle (T, J, 3)."""
    if x.size == 3 * joints:  # of all frames
        x = np.broadcast_to(x.reshape(1, joints, 3), (frames, joints, 3))
    rows = by_frame(x, frames, joints, 3)
    if rows is not None:
        return rows
    matrices = by_frame(x, frames, joints, 3, 3)
    if matrices is None:
        hint = ", axis-angle; components of a PCA need the body that they belong to"
        raise InputError(
            f"{where}: '{name}' must be ({frames}, {3 * joints}){hint if 'hand' in name else ''}; "
            f"got {x.shape}"
        )
    known = np.isfinite(matrices).all((-1, -2), keepdims=True)
    matrices = np.where(known, matrices, np.eye(3))
    product = matrices @ matrices.swapaxes(-1, -2)  # orthogonal to a few digits
    if np.abs(product - np.eye(3)).max() > 0.1 or (np.linalg.det(matrices) < 0).any():
        raise InputError(f"{where}: '{name}' {x.shape} must hold rotation matrices")
    return np.where(known[..., 0], to_rotvecs(nearest_rotations(matrices)), np.nan)


def by_frame(x: np.ndarray, frames: int, *row: int) -> np.ndarray | None:
    """Return an array as (frames, *row) if these are its axes, flat or not, else None.

    Axes of length 1 do not count, but an array of the right size with other axes is not taken.
    """
    if x.size != frames * int(np.prod(row)):
        return None
    axes = [n for n in x.shape if n != 1]
    first, rest = axes[:1], axes[1:] if frames > 1 else axes
    if (frames > 1 and first != [frames]) or (len(rest) > 1 and rest[-1] != row[-1]):
        return None
    return x.reshape(frames, *row)


def _root_and_body(arrays: NamedArrays, root: str, orient: np.ndarray) -> JointRotations:
    """Return the joints of a root and a body in arrays of their own."""
    where, matrix = arrays.where, orient.ndim > 2 and orient.shape[-2:] == (3, 3)
    frames = orient.size // (9 if matrix else 3)
    if not frames or orient.shape[-1] != 3:
        raise InputError(f"{where}: '{root}' must be (T, 3) or (T, 3, 3), got {orient.shape}")
    rotations = np.zeros((frames, len(JOINTS), 3))
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
    return JointRotations(rotations, SMPL.name if count in (23, 24) else SMPLX.name, False)


def _with_parts(
    arrays: NamedArrays, found: JointRotations, form: str, components: np.ndarray | None
) -> JointRotations:
    """Return the joints with hands, jaw and eyes that arrays of their own hold.

    With any of these the body is a ``form``.
    """
    where, rotations, frames = arrays.where, found.rotations, len(found.rotations)
    names, from_mean = {}, False
    for ours, part in _OTHERS.items():
        name, x = arrays.take(ours)
        if name is None:
            continue
        names[ours] = name
        few = x.ndim == 2 and len(x) == frames and 0 < x.shape[1] < _FINGERS
        if ours in ("left_hand_pose", "right_hand_pose") and few:
            side = int(ours == "right_hand_pose")
            x, from_mean = _fingers(where, name, x, components, side), True
        rotations[:, part] = axis_angles(where, name, x, frames, part.stop - part.start)
    form = form if names else found.form
    if form == SMPLX.name and names.get("hands") == "pose_hand" and "jaw_pose" not in names:
        form = SMPLH.name  # AMASS's
    hands = any("hand" in ours for ours in names)
    return replace(found, form=form, has_hands=hands, from_mean_hand=from_mean)


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
