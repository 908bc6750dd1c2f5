"""Read hands that a hand estimator found, frame by frame: HaMeR, WiLoR, WiLoR-mini, Dyn-HaMR.

Their programs write no file of one form; people save what the networks return. Its parts have the
same names everywhere, at any depth:

=================================================  ==========================================
``hand_pose``, ``pose_body``, ``mano_pose``        fingers of one hand or of several, as
                                                   matrices (15, 3, 3) or axis-angle (45)
``global_orient``, ``root_orient``                 the wrist in the camera's axes
``is_right``, ``right``, ``all_right``             1 or 0 for each hand, or ``hand_type``: a word
``hand_bbox``, ``bbox``                            x0, y0, x1, y1 in pixels
=================================================  ==========================================

A list has an entry for each frame, or for each hand where the frame is known: by the number of a
file in a folder, or of a key. Arrays of a whole video have a row for each frame.

MANO's fingers are SMPL-X's, in the same order. Networks see a left hand mirrored, as a right one.
Some programs mirror it back and some do not, and none says so: fingers bend toward the palm, so the
sign of their bend tells. A rotation is mirrored by changing the signs of its y and z.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.body.pose import SIDES
from gva_mi.core.errors import InputError, expecting
from gva_mi.core.files import read_json
from gva_mi.data.importers.estimator_files import read_source
from gva_mi.data.importers.joint_rotations import axis_angles
from gva_mi.data.importers.numbering import counted_from_0

MIRROR = np.array([1.0, -1.0, -1.0])
_POSES = ("hand_pose", "pose_body", "mano_pose", "hand_poses", "pred_hand_pose")
_WRISTS = ("global_orient", "root_orient")
_RIGHT = ("is_right", "right", "all_right", "is_rights")
_WORDS = ("hand_type", "hand_side", "handedness", "side")
_BOXES = ("hand_bbox", "bbox", "box")
_EXPECTED = "hands of HaMeR or WiLoR: hand_pose with is_right, for each frame"
_SUFFIXES = (".npz", ".npy", ".pkl", ".pt", ".json")
_FINGERS = slice(0, 12)  # joints that bend about one axis; the thumb has others


@dataclass(frozen=True)
class ForeignHand:
    """A hand in a frame."""

    side: str
    frame: int
    fingers: np.ndarray  # (15, 3) axis-angle
    wrist: np.ndarray | None  # (3,) axis-angle, in the camera's axes
    centre: np.ndarray | None  # (2,) pixels


def read_hands(path: Path, first: int = 0) -> tuple[list[ForeignHand], list[str]]:
    """Read the hands of a file or folder; return them as their sides have them, and notes.

    Their frames count from 0. Numbers in names count from 0 or 1 if one of them is that, and else
    from ``first``.
    """
    with expecting(path, _EXPECTED):
        found = list(_found(path, _content(path), None, {}, first))
    if not found:
        raise InputError(f"{path}: holds no hands; expected {_EXPECTED}")
    left = [hand for hand in found if hand.side == "left"]
    bend = np.median([hand.fingers[_FINGERS, 2].mean() for hand in left]) if left else -1.0
    if bend <= 0:
        return found, []
    for k, h in enumerate(found):
        if h.side == "left":
            wrist = None if h.wrist is None else h.wrist * MIRROR
            found[k] = replace(h, fingers=h.fingers * MIRROR, wrist=wrist)
    return found, ["left hands bend as right ones, so they are mirrored back"]


def _content(path: Path) -> Any:  # noqa: ANN401
    if path.suffix.lower() == ".json":
        return read_json(path, _EXPECTED)
    return read_source(path, _EXPECTED)


def _found(
    where: Path,
    value: Any,  # noqa: ANN401
    frame: int | None,
    about: Mapping[str, Any],
    first: int,
) -> Iterator[ForeignHand]:
    """Yield the hands in a value of a file; ``about`` is what is said around it."""
    if isinstance(value, np.ndarray) and value.dtype.hasobject:
        value = value.tolist()
    if isinstance(value, Path):
        paths = sorted(p for p in value.iterdir() if p.suffix.lower() in _SUFFIXES)
        for path, number in zip(paths, counted_from_0(paths, first), strict=True):
            yield from _found(path, _content(path), number, {}, first)
    elif isinstance(value, list | tuple):
        for k, item in enumerate(value):
            own = {name: x[k] if np.ndim(x) and len(x) == len(value) else x
                   for name, x in about.items()}  # fmt: skip
            yield from _found(where, item, k if frame is None else frame, own, first)
    elif isinstance(value, Mapping):
        known = {n: value[n] for n in (*_RIGHT, *_WORDS, *_BOXES) if value.get(n) is not None}
        about = {**about, **known}
        name = next((n for n in _POSES if value.get(n) is not None), None)
        if name is not None:
            yield from _hands_of(where, name, value, frame, about)
            return
        numbered = frame is None and all(re.search(r"\d", str(key)) for key in value)
        numbers = counted_from_0(list(value), first) if numbered else [frame] * len(value)
        for (key, inner), number in zip(value.items(), numbers, strict=True):
            if isinstance(inner, Mapping | list | tuple | np.ndarray):
                side = {"hand_type": key} if str(key).lower() in SIDES else {}
                yield from _found(where, inner, number, {**about, **side}, first)


def _hands_of(
    where: Path, name: str, value: Mapping, frame: int | None, about: Mapping[str, Any]
) -> Iterator[ForeignHand]:
    """Yield the hands of one array of fingers, with what is said of them."""
    fingers = _rotations(where, name, value[name], 15)
    count = len(fingers)
    wrists = next((_rotations(where, n, value[n], 1) for n in _WRISTS if value.get(n) is not None),
                  [None] * count)  # fmt: skip
    rights = _sides(where, about, count)
    boxes = next((np.reshape(about[n], (-1, np.shape(about[n])[-1]))[:, :4] for n in _BOXES
                  if n in about and np.ndim(about[n])), [None] * count)  # fmt: skip
    boxes = boxes if len(boxes) == count else [None] * count
    if len(wrists) != count:
        raise InputError(f"{where}: {len(wrists)} wrists for {count} hands of '{name}'")
    # Several videos' worth of rows, (hands, frames, ...): frames run in the last axis.
    shape = np.shape(value[name])
    of_hand = 3 if shape[-2:] == (3, 3) else 2 if shape[-1] == 3 else 1  # axes of one
    rows = shape[1] if len(shape) - of_hand == 2 else count
    for k in range(count):
        yield ForeignHand(
            SIDES[int(rights[k])], k % rows if frame is None else frame, fingers[k],
            None if wrists[k] is None else wrists[k][0],
            None if boxes[k] is None else (boxes[k][:2] + boxes[k][2:]) / 2,
        )  # fmt: skip


def _rotations(where: Path, name: str, value: Any, joints: int) -> np.ndarray:  # noqa: ANN401
    """Return axis-angle (n, joints, 3) of an array with any axes before those of one hand."""
    array = np.asarray(value, np.float64)
    flat = array.reshape(-1, joints, 3, 3) if array.shape[-2:] == (3, 3) else None
    if flat is None and array.size % (3 * joints) == 0 and array.size:
        flat = array.reshape(-1, joints, 3)
    if flat is None:
        raise InputError(
            f"{where}: '{name}' must be matrices ({joints}, 3, 3) or axis-angle ({3 * joints}) of "
            f"each hand, got {array.shape}; components of a PCA are not read"
        )
    return axis_angles(f"{where}", name, flat, len(flat), joints)


def _sides(where: Path, about: Mapping[str, Any], count: int) -> np.ndarray:
    """Return whether each of ``count`` hands is a right one."""
    for name in _WORDS:
        if str(about.get(name, "")).lower() in SIDES:
            return np.full(count, SIDES.index(str(about[name]).lower()))
    given = next((about[name] for name in _RIGHT if name in about), None)
    if given is None:
        raise InputError(f"{where}: says of no hand which it is; expected {_EXPECTED}")
    rights = np.ravel(np.asarray(given, np.float64))
    rights = np.broadcast_to(rights, count) if rights.size == 1 else rights
    if rights.size != count or not np.isin(rights, (0, 1)).all():
        raise InputError(f"{where}: 'is_right' must be 0 or 1 for {count} hands, got {rights}")
    return rights
