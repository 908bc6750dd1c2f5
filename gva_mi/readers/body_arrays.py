"""Find the arrays of a body in a file by their public names: :func:`find_body`.

:data:`ARRAY_NAMES` is the table: our name of an array, and the names under which programs write it.
The first name that a file holds is taken, also in camel case or with the name of a model before it
(``smplx_body_pose``, ``bodyPose``). The arrays may lie in a dictionary of their own, such as
``params``, or in several (:func:`posed_parts`).

Rotations are axis-angle or matrices, flat or joint by joint. The numbers of a row name the body:

=========  ==========================================================================
Numbers    Joints
=========  ==========================================================================
165        SMPL-X: all 55 joints
156        SMPL+H: 22 joints and both hands
72         SMPL: 22 joints and two mittens, which are left out
66         the 22 joints that all bodies have, with hands and face beside them or without
63, 69     SMPL-X's or SMPL's joints below the root, which ``global_orient`` turns
=========  ==========================================================================

With ``Rh`` and ``Th``, as of EasyMocap, the body turns about the origin: x = R(Rh) b + Th.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from gva_mi.body.body_file import FORMATS, SMPL, SMPLH, SMPLX
from gva_mi.body.pose import BODY, JOINTS, LEFT_HAND, RIGHT_HAND, SMPLX_FIELDS
from gva_mi.body.rotations import composed, nearest_rotations, to_matrices, to_rotvecs
from gva_mi.core.errors import InputError

ALL_JOINTS_NAMES = ("poses", "pose", "fullpose", "full_pose", "pose_aa", "thetas")  # in a row
ARRAY_NAMES = {
    "global_orient": ("global_orient", "root_orient", "root_pose", "poses_root", "global_rot"),
    "body_pose": ("body_pose", "pose_body", "poses_body"),
    "left_hand_pose": ("left_hand_pose", "lhand_pose", "pose_lhand", "left_hand", "lhand"),
    "right_hand_pose": ("right_hand_pose", "rhand_pose", "pose_rhand", "right_hand", "rhand"),
    "hands": ("pose_hand", "hand_pose"),  # left before right
    "jaw_pose": ("jaw_pose", "pose_jaw"),
    "leye_pose": ("leye_pose",),
    "reye_pose": ("reye_pose",),
    "eyes": ("pose_eye", "eye_pose"),
    "transl": (
        "trans", "transl", "translation", "global_transl", "global_body_translation", "global_t",
        "root_trans", "root_translation", "root_pos", "cam_trans", "body_translation", "tran", "Th",
        "trans_orig",
    ),
    "scaled": ("scaling", "body_scale"),  # of AIST++: x = s b + t
    "betas": ("betas", "beta", "shape", "shapes", "body_shape"),
    "expression": ("expression", "expressions", "expr", "exp", "face_expr"),
}  # fmt: skip
# Names of arrays that are neither pose nor shape (lens, time, boxes): no note says that they are
# unused.
NOT_BODY_NAMES = set(
    "K cam_K intrinsic intrinsics focal focal_length focal_l princpt bbox width height frame_ids "
    "frame_id frame time stage offsets".split()
)
JOINTS_OF_ARRAY = {  # our name of an array: SMPL-X's joints that it holds
    **SMPLX_FIELDS,
    "hands": slice(LEFT_HAND.start, RIGHT_HAND.stop),
    "eyes": slice(23, 25),
}
_HANDS_AND_FACE = {
    name: joints for name, joints in JOINTS_OF_ARRAY.items()
    if name not in ("global_orient", "body_pose")
}  # fmt: skip
# Length of a row: number of joints in it, as axis-angle (3 each) or matrices (9 each).
_JOINTS_BY_ROW_LENGTH = {k * n: n for n in (*FORMATS, BODY.stop) for k in (3, 9)}
_BELOW_ROOT = {63, 69, 189, 207}  # length of a row of the joints below the root: SMPL-X's, SMPL's
_MODEL_PREFIX = re.compile("^((smpl[xh]?|pred|gt)_)+")  # what programs write before a name
_CAMEL_CASE_BREAK = re.compile("(?<=[a-z0-9])(?=[A-Z])")
_NESTING_DEPTH = 3  # levels of dictionaries that are searched. Chosen: no known program has more
# Radians, four turns. Chosen: some programs add whole turns to a limb's rotation, but fewer. Angles
# in degrees exceed it, because arms that hang down are rotated by more than 25 of them.
_LARGEST_ROTATION = 4 * 2 * np.pi


@dataclass(frozen=True)
class FoundBody:
    """A body's arrays in T frames, in the file's own axes."""

    rotations: np.ndarray  # (T, 55, 3) axis-angle, radians; may hold NaN
    form: str  # "SMPL", "SMPL+H" or "SMPL-X"
    has_hands: bool
    transl: np.ndarray | None = None  # (T, 3) metres, of a body that is not scaled
    about_origin: np.ndarray | None = None  # (T, 3, 3) turns, where the body turns about the origin
    betas: np.ndarray | None = None  # (B,), or (n, B) if they differ between frames
    expression: np.ndarray | None = None  # (T, E)
    unused: tuple[str, ...] = ()  # names of the other arrays of numbers


def find_body(where: str, found: Mapping[str, Any]) -> FoundBody:
    """Find a body's joint rotations, translation and shape in T frames."""
    arrays = NamedArrays(where, unnested(found))
    body = _rotations(arrays)
    if body is None:
        names = ", ".join(sorted(map(str, found))[:12]) or "nothing"
        raise InputError(
            f"{where}: holds no poses of one person; expected one of "
            f"{', '.join(ALL_JOINTS_NAMES)}, or root_orient and pose_body, or global_orient "
            f"and body_pose; found: {names}"
        )
    frames = len(body.rotations)
    turns, place = None, "transl"
    if {"Rh", "Th"} <= arrays.keys():
        Rh, place = _vectors(where, *arrays.take("Rh"), frames), "Th"
        body.rotations[:, 0] = composed(Rh, body.rotations[:, 0])
        turns = to_matrices(Rh)
    transl, betas = _translation(arrays, place, frames), _betas(arrays)
    face = _expression(arrays, frames)
    unused = arrays.unused()
    return replace(
        body, transl=transl, about_origin=turns, betas=betas, expression=face, unused=unused
    )


class NamedArrays(dict):
    """A file's arrays by name, which records the arrays that were used."""

    def __init__(self, where: str, found: Mapping[str, Any]) -> None:
        super().__init__({k: x for k, x in found.items() if x is not None})
        self.where, self.taken = where, set()
        self._own = {plain_name(k): k for k in reversed(self)}  # the first of a plain name

    def find(self, *names: str) -> str | None:
        """Return the file's own name of the first of ``names``, ours or the file's, it holds."""
        public = [name for ours in names for name in ARRAY_NAMES.get(ours, (ours,))]
        found = (name if name in self else self._own.get(name) for name in public)
        return next((name for name in found if name is not None), None)

    def take(self, *names: str) -> tuple[str, np.ndarray] | tuple[None, None]:
        """Return name and numbers (float64, at least 1-D) of what :meth:`find` finds."""
        name = self.find(*names)
        if name is None:
            return None, None
        self.taken.add(name)
        try:
            array = np.asarray(self[name])
            array = array if array.dtype.kind != "c" else array.astype(str)  # refused
            return name, np.atleast_1d(array.astype(np.float64))
        except (ValueError, TypeError):
            raise InputError(
                f"{self.where}: '{name}' must be numbers, got {self[name]!s:.40}"
            ) from None

    def cover(self, *names: str) -> None:
        """Mark ``names`` of ours as used, because another array repeats them."""
        public = {name for ours in names for name in ARRAY_NAMES[ours]}
        self.taken |= {own for plain, own in self._own.items() if plain in public}

    def unused(self) -> tuple[str, ...]:
        """Return the names of number arrays that were not used."""
        return tuple(str(k) for k, x in self.items() if k not in self.taken and is_numbers(x))


def plain_name(name: object) -> str:
    """Return a name in lower case with underscores, without a model's name before it."""
    return _MODEL_PREFIX.sub("", _CAMEL_CASE_BREAK.sub("_", str(name)).lower())


def is_numbers(x: Any) -> bool:  # noqa: ANN401
    """Whether a value of a file is an array of more than one number."""
    return isinstance(x, np.ndarray) and x.size > 1 and x.dtype.kind in "biuf"


def listed_names(names: Sequence[str]) -> str:
    """Return the first of the given names, and how many more there are."""
    more = f" and {len(names) - 12} more" if len(names) > 12 else ""
    return ", ".join(names[:12]) + more


def holds_pose(found: Any) -> bool:  # noqa: ANN401
    """Whether a file's content has poses of a body by name."""
    names = {*ALL_JOINTS_NAMES, *ARRAY_NAMES["body_pose"]}
    return isinstance(found, Mapping) and any(
        plain_name(name) in names and x is not None and not isinstance(x, Mapping)
        for name, x in found.items()
    )


def unnested(found: Any, deep: int = _NESTING_DEPTH) -> Any:  # noqa: ANN401
    """Move parameters from an inner dictionary into the outer one.

    This is done if exactly one inner dictionary holds poses. Anything else is returned as it is.
    """
    inner = posed_parts(found, deep)
    return next(iter(inner.values())) if len(inner) == 1 else found


def posed_parts(found: Any, deep: int = _NESTING_DEPTH) -> dict[Any, dict]:  # noqa: ANN401
    """Return the inner dictionaries that hold poses, each with what is beside them."""
    if not isinstance(found, Mapping) or holds_pose(found) or not deep:
        return {}
    inner = {name: unnested(one_object(x), deep - 1) for name, x in found.items()}
    inner = {name: x for name, x in inner.items() if holds_pose(x)}
    outer = {name: x for name, x in found.items() if name not in inner}
    return {name: outer | dict(x) for name, x in inner.items()}


def one_object(found: Any) -> Any:  # noqa: ANN401
    """Return the object in an array of one object, as numpy stores a dictionary; else ``found``."""
    one = isinstance(found, np.ndarray) and found.dtype.hasobject and found.size == 1
    return found.item() if one else found


def _rotations(arrays: NamedArrays) -> FoundBody | None:
    """Find the joints of T frames; None if the arrays hold no poses."""
    name, pose = arrays.take(*ALL_JOINTS_NAMES)
    below_root = name is None or math.prod(pose.shape[pose.ndim > 1 :]) in _BELOW_ROOT
    if name is None:
        name, pose = arrays.take("body_pose")
    if name is None:
        return None
    root, orient = arrays.take("global_orient")
    if root is None and {pose.size, math.prod(pose.shape[1:])} & _BELOW_ROOT:
        root, orient = arrays.take("Rh")  # find_body turns the body by it
        if root is None:
            raise InputError(
                f"{arrays.where}: '{name}' {pose.shape} lacks the root's rotation, and no array "
                f"beside it is one of {', '.join(ARRAY_NAMES['global_orient'])}"
            )
        orient = 0 * orient
    if root is None or not below_root:
        body, form = _of_all_joints(arrays.where, name, pose)
        arrays.cover(*(JOINTS_OF_ARRAY if body.has_hands else ("global_orient", "body_pose")))
        own = body.rotations[:, :1]
        if root is not None and not own.any():
            own[:] = axis_angles(arrays.where, root, orient, len(own), 1)
        elif root is not None and np.abs(np.resize(orient, own.shape) - own).max() > 1e-3:
            arrays.taken.discard(root)  # a note names it
    else:
        body = _of_root_and_body(arrays.where, root, orient, name, pose)
        form = body.form
    body = body if body.has_hands else _with_extremities(arrays, body, form)
    turns = np.nan_to_num(np.linalg.norm(body.rotations[:, 1:], axis=2))
    if (largest := float(np.median(turns, axis=0).max())) > _LARGEST_ROTATION:
        raise InputError(
            f"{arrays.where}: a limb is turned by {largest:.0f} radians in most frames, such as by "
            "rotations in degrees; expected axis-angle in radians"
        )
    return body


def _of_all_joints(where: str, name: str, pose: np.ndarray) -> tuple[FoundBody, str]:
    """Return a pose with all joints in a row, (T, 3 J), and the form of hands beside it."""
    rows = pose[None] if pose.ndim == 1 else pose
    if rows.ndim > 2 and len(rows) == 1 and rows[0].size not in _JOINTS_BY_ROW_LENGTH:
        rows = rows[0]  # a batch of one motion
    numbers = rows[0].size if len(rows) else 0
    axes = [n for n in rows.shape[1:] if n > 1]
    if numbers not in _JOINTS_BY_ROW_LENGTH or (len(axes) > 1 and axes[-1] != 3):
        raise InputError(
            f"{where}: '{name}' has {numbers} numbers a frame; expected axis-angle, 165 (SMPL-X), "
            f"156 (SMPL+H), 72 (SMPL) or 66 (its 22 joints above the hands), or matrices, and no "
            f"quaternions; got {pose.shape}"
        )
    count = _JOINTS_BY_ROW_LENGTH[numbers]
    angles = axis_angles(where, name, rows, len(rows), count)
    rotations = np.zeros((len(angles), len(JOINTS), 3))
    form = FORMATS.get(count, SMPL)
    joints = list(range(BODY.stop)) if form is SMPL else list(form.joints)  # without mittens
    rotations[:, joints] = angles[:, : len(joints)]
    beside = SMPLX.name if count == BODY.stop else form.name
    return FoundBody(rotations, form.name, form is not SMPL), beside


def _of_root_and_body(
    where: str, root: str, orient: np.ndarray, name: str, body: np.ndarray
) -> FoundBody:
    """Return the joints of a root and a body in arrays of their own."""
    matrix = orient.ndim > 2 and orient.shape[-2:] == (3, 3)
    frames = orient.size // (9 if matrix else 3)
    if not frames or orient.shape[-1] != 3:
        raise InputError(f"{where}: '{root}' must be (T, 3) or (T, 3, 3), got {orient.shape}")
    rotations = np.zeros((frames, len(JOINTS), 3))
    rotations[:, :1] = axis_angles(where, root, orient, frames, 1)
    # SMPL's 23 joints have mittens; 22 and 24 repeat the root.
    numbers = body.size / frames
    count = next((n for n in (21, 23, 22, 24) if numbers in (3 * n, 9 * n)), 21)
    angles = axis_angles(where, name, body, frames, count)
    rotations[:, BODY] = angles[:, count in (22, 24) :][:, :21]
    return FoundBody(rotations, SMPL.name if count in (23, 24) else SMPLX.name, False)


def _with_extremities(arrays: NamedArrays, body: FoundBody, form: str) -> FoundBody:
    """Return the joints with hands, jaw and eyes of arrays of their own.

    With any of these the body is a ``form``.
    """
    names, frames, mittens = {}, len(body.rotations), False
    for ours, part in _HANDS_AND_FACE.items():
        name, x = arrays.take(ours)
        count = part.stop - part.start
        if name is not None and "hand" in ours and x.size == frames * count // 5:
            mittens = True  # SMPL's hands: one joint each
        elif name is not None:
            names[ours] = name
            if x.ndim > 2 and x.shape[-2:] == (3, 3):  # zeros: the joint was not estimated
                x = np.where(x.any((-2, -1), keepdims=True), x, np.eye(3))
            body.rotations[:, part] = axis_angles(arrays.where, name, x, frames, count)
    form = SMPL.name if mittens else form if names else body.form
    if form == SMPLX.name and names.get("hands") == "pose_hand" and "jaw_pose" not in names:
        form = SMPLH.name  # AMASS's
    return replace(body, form=form, has_hands=any("hand" in ours for ours in names))


def axis_angles(where: str, name: str, x: np.ndarray, frames: int, joints: int) -> np.ndarray:
    """Convert T frames of so many joints, of any shape, to axis-angle (T, J, 3)."""
    if x.size == 3 * joints:  # of all frames
        x = np.broadcast_to(x.reshape(1, joints, 3), (frames, joints, 3))
    rows = _by_frame(x, frames, joints, 3)
    if rows is not None:
        return rows
    matrices = _by_frame(x, frames, joints, 3, 3)
    if matrices is None:
        hint = ", axis-angle and no components of a PCA" if "hand" in name else ""
        raise InputError(f"{where}: '{name}' must be ({frames}, {3 * joints}){hint}; got {x.shape}")
    known = np.isfinite(matrices).all((-1, -2), keepdims=True)
    matrices = np.where(known, matrices, np.eye(3))
    product = matrices @ matrices.swapaxes(-1, -2)  # orthogonal to a few digits
    if np.abs(product - np.eye(3)).max() > 0.1 or (np.linalg.det(matrices) < 0).any():
        raise InputError(f"{where}: '{name}' {x.shape} must hold rotation matrices")
    return np.where(known[..., 0], to_rotvecs(nearest_rotations(matrices)), np.nan)


def _by_frame(x: np.ndarray, frames: int, *row: int) -> np.ndarray | None:
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


def _vectors(where: str, name: str, x: np.ndarray, frames: int) -> np.ndarray:
    """Return an array of vectors as (T, 3), or refuse it."""
    rows = _by_frame(x, frames, 3)
    if rows is None:
        raise InputError(f"{where}: '{name}' must be ({frames}, 3), got {x.shape}")
    return rows


def _translation(arrays: NamedArrays, ours: str, frames: int) -> np.ndarray | None:
    """Return the translation (T, 3), metres, of the body at its own size.

    A file may scale the body by s. A camera sees x = s b + t as b + t / s, so t is divided by s.
    """
    name, transl = arrays.take(ours)
    if name is None:
        return None
    transl = _vectors(arrays.where, name, transl, frames)
    key, scale = arrays.take("scaled")
    if key is None:
        return transl
    scale = scale.ravel()
    if scale.size not in (1, frames) or not ((scale > 0) & (scale < np.inf)).all():
        raise InputError(f"{arrays.where}: '{key}' must be one number above 0, got {scale}")
    return transl / scale[:, None]


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


def _expression(arrays: NamedArrays, frames: int) -> np.ndarray | None:
    name, face = arrays.take("expression")
    if name is None or not face.size:
        return None
    rows = face.reshape(1 if face.size == face.shape[-1] else len(face), -1)
    if len(rows) not in (1, frames):  # one row is every frame's
        raise InputError(f"{arrays.where}: '{name}' must be ({frames}, n), got {face.shape}")
    return np.broadcast_to(rows, (frames, rows.shape[1]))
