"""Names under which programs write a body's arrays, and where these lie in a file.

The first name that a file holds is taken, also in camel case or behind the name of a model
(``smplx_body_pose``, ``bodyPose``). Arrays may lie in a dictionary of their own, such as
``params``, or be the file's only one, without a name.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from gva_mi.core.errors import InputError

WHOLE = ("poses", "pose", "fullpose", "full_pose", "thetas")
SPELLINGS = {  # by our names; the first that a file holds is taken
    "global_orient": ("global_orient", "root_orient", "root_pose", "global_rot"),
    "body_pose": ("body_pose", "pose_body"),
    "left_hand_pose": ("left_hand_pose", "lhand_pose", "pose_lhand", "left_hand", "lhand"),
    "right_hand_pose": ("right_hand_pose", "rhand_pose", "pose_rhand", "right_hand", "rhand"),
    "hands": ("pose_hand", "hand_pose"), "jaw_pose": ("jaw_pose", "pose_jaw"),
    "leye_pose": ("leye_pose",), "reye_pose": ("reye_pose",), "eyes": ("pose_eye", "eye_pose"),
    "face": ("head_pose",),  # of Meshcapade's .smpl: jaw and eyes
    "transl": (
        "trans", "transl", "translation", "global_body_translation", "root_trans", "global_transl",
        "cam_trans", "body_translation", "root_translation", "root_pos", "root_position", "tran",
        "global_t", "Th",
    ),
    "betas": ("betas", "beta", "shape", "shapes", "body_shape", "shape_parameters"),
    "expression": (
        "expression", "expressions", "expr", "exp", "face_expr", "expression_parameters",
    ),
}  # fmt: skip
# Names of what is neither pose nor shape: lens, time, boxes.
OTHERS = set(
    "K cam_K intrinsic intrinsics focal focal_length focal_l princpt bbox width height frame_ids "
    "frame_id frame time stage offsets".split()
)
_DEEP = 3  # dictionaries in dictionaries
_MODEL = re.compile("^((smpl[xh]?|pred|gt)_)+")  # before a name
_CAMEL = re.compile("(?<=[a-z0-9])(?=[A-Z])")
# By the numbers of a row, or of a frame's joints, what programs write without names.
_NO_POSES = {
    (263,): "HumanML3D's features of a motion",
    (251,): "KIT-ML's features of a motion",
    (265,): "TalkSHOW's parameters of body, hands and face",
    (322,): "Motion-X's parameters: root, body, hands, jaw, face, its shape, translation, betas",
    (22, 3): "positions of 22 joints, as HumanML3D has them",
}


class NamedArrays(dict):
    """A file's arrays by name; it keeps which of them were taken."""

    def __init__(self, where: str, found: Mapping[str, Any]) -> None:
        super().__init__({k: x for k, x in found.items() if x is not None})
        self.where, self.taken = where, set()
        self._own = {plain_name(k): k for k in reversed(self)}  # the first of a plain name

    def take(self, *names: str) -> tuple[str, np.ndarray] | tuple[None, None]:
        """Return name and numbers (float64, 1-D at least) of the first of ``names`` that is there;
        spellings of a part that is ours count as its names."""
        name = self._first(names)
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

    def holds(self, *names: str) -> bool:
        """Whether one of ``names`` is there, or a spelling of it."""
        return self._first(names) is not None

    def cover(self, *names: str) -> None:
        """Count ``names`` and their spellings as taken, because other arrays hold the same."""
        spelled = {name for ours in names for name in SPELLINGS[ours]}
        self.taken |= {own for plain, own in self._own.items() if plain in spelled}

    def _first(self, names: tuple[str, ...]) -> str | None:
        spelled = [name for ours in names for name in SPELLINGS.get(ours, (ours,))]
        found = (name if name in self else self._own.get(name) for name in spelled)
        return next((name for name in found if name is not None), None)

    def unused(self) -> tuple[str, ...]:
        """Return the names of arrays of numbers that were not taken."""
        return tuple(str(k) for k, x in self.items() if k not in self.taken and is_numbers(x))


def plain_name(name: object) -> str:
    """Return a name in lower case with underscores, without that of a model before it."""
    return _MODEL.sub("", _CAMEL.sub("_", str(name)).lower())


def is_numbers(x: Any) -> bool:  # noqa: ANN401
    """Whether a value of a file is an array of more than one number."""
    return isinstance(x, np.ndarray) and x.size > 1 and x.dtype.kind in "biuf"


def holds_pose(found: Any) -> bool:  # noqa: ANN401
    """Whether a file's content has the poses of a body by name."""
    names = {*WHOLE, *SPELLINGS["body_pose"]}
    return isinstance(found, Mapping) and any(
        plain_name(name) in names and x is not None and not isinstance(x, Mapping)
        for name, x in found.items()
    )


def unnested(found: Any, deep: int = _DEEP) -> Any:  # noqa: ANN401
    """Return a dictionary in whose only inner dictionary with poses the parameters lie with these
    parameters by name, the outer names kept; anything else as it is."""
    if not isinstance(found, Mapping) or holds_pose(found) or not deep:
        return found
    inner = {name: unnested(one_object(x), deep - 1) for name, x in found.items()}
    posed = [name for name, x in inner.items() if holds_pose(x)]
    if len(posed) != 1:
        return found
    outer = {name: x for name, x in found.items() if name != posed[0]}
    return outer | dict(inner[posed[0]])


def one_object(found: Any) -> Any:  # noqa: ANN401
    """Return what an array of one object holds, numpy's way to keep a dictionary; else the same."""
    one = isinstance(found, np.ndarray) and found.dtype.hasobject and found.size == 1
    return found.item() if one else found


def named_rows(where: object, rows: np.ndarray) -> dict[str, np.ndarray]:
    """Return an array without names as the poses that its shape says it is.

    Poses are (T, 72), (T, 156), (T, 165), or joint by joint, the root first.
    """
    shape = rows.shape[1:]
    if shape in _NO_POSES:
        what = f"which has the shape of {_NO_POSES[shape]}, and not of rotations by joint"
    elif shape in {(72,), (156,), (165,), (24, 3), (52, 3), (55, 3)} or (
        shape[1:] == (3, 3) and shape[0] in (22, 24, 52, 55)
    ):
        return {"poses": rows}
    else:
        what = "which could be any parameters in any order"
    raise InputError(
        f"{where}: an array {rows.shape} without names, {what}; save them by name: "
        "global_orient, body_pose, transl, betas (.npz)"
    )
