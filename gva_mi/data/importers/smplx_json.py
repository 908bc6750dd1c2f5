"""SMPL-X as the line of NeuralAnnot, Hand4Whole, OSX and ExAvatar writes it: JSON, a file a frame.

===================  =================================================  =======================
Who writes them      Names                                              Camera
===================  =================================================  =======================
NeuralAnnot, OSX     ``smplx_param`` with ``root_pose``,                ``cam_param``
                     ``body_pose``, ``lhand_pose``, ``rhand_pose``,
                     ``jaw_pose``, ``shape``, ``expr``, ``trans``
ExAvatar             these alone                                        ``cam_params/12.json``
forks of SMPLest-X   the same with ``left_hand_pose``,                  ``camera_metadata.json``
                     ``right_hand_pose``, ``betas``, ``translation``    beside
===================  =================================================  =======================

OSX's own demo and SMPLest-X's own inference keep pictures and meshes and no parameters: their
forks do. All make the body with the package's default, to which the mean hand is added.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.data.importers.readings import View, follow, make_track
from gva_mi.data.importers.tracks import Track
from gva_mi.data.importers.whole_videos import last_number
from gva_mi.errors import InputError
from gva_mi.files import read_json

NAMES = {
    "root_pose": "global_orient", "body_pose": "body_pose", "jaw_pose": "jaw_pose",
    "lhand_pose": "left_hand_pose", "left_hand_pose": "left_hand_pose",
    "rhand_pose": "right_hand_pose", "right_hand_pose": "right_hand_pose",
    "leye_pose": "leye_pose", "reye_pose": "reye_pose", "shape": "betas", "betas": "betas",
    "trans": "transl", "translation": "transl",
}  # fmt: skip
PARAMETERS = "SMPL-X's parameters of a frame (.json)"
CAMERA = 'a camera such as {"focal": [fx, fy], "princpt": [cx, cy]}'
_CAMERA = "camera_metadata.json"  # of a fork of SMPLest-X
_FRAME_PERSON = re.compile(r"(?:^|_)(\d+)_(?:person_?)?\d+$")


def is_osx(found: Any) -> bool:  # noqa: ANN401
    files = _files(found)
    if not files:
        return False
    first = read_json(files[0], PARAMETERS)
    params = first.get("smplx_param", first) if isinstance(first, dict) else None
    return isinstance(params, dict) and {"root_pose", "body_pose"} <= set(params)


def read_osx(where: str, found: Path, view: View) -> list[Track]:
    """Who is nearest goes on: such files number the people of each frame anew."""
    frames: dict[int, list[tuple[dict[str, np.ndarray], np.ndarray]]] = {}
    for path in _files(found):
        content = read_json(path, PARAMETERS)
        params = content.get("smplx_param", content)
        frames.setdefault(_frame_of(path), []).append(
            (parameters(str(path), [params]), _lens(path, content))
        )
    numbers = sorted(frames)
    names = follow([[p["transl"][0] for p, _ in frames[k]] for k in numbers])
    people: dict[str, list[tuple[int, dict[str, np.ndarray], np.ndarray]]] = {}
    for number, row in zip(numbers, names, strict=True):
        for name, (params, K) in zip(row, frames[number], strict=True):
            people.setdefault(name, []).append((number, params, K))
    tracks = []
    for name, seen in people.items():
        at = f"{where}: person {name}"
        given = together(at, [params for _, params, _ in seen])
        K = np.stack([K for _, _, K in seen])
        track = make_track(at, name, np.array([number for number, _, _ in seen]), given, K)
        tracks.append(replace(track, from_mean_hand=track.has_hands))
    return tracks


def parameters(where: str, each: Sequence[Mapping[str, Any]]) -> dict[str, np.ndarray]:
    """Parameters of some frames by SMPL-X's names, a row a frame.

    Raises:
        InputError: no place of the person, or numbers that are none.
    """
    rows = []
    for params in each:
        rows.append({
            NAMES[key]: np.ravel(np.asarray(value, np.float64))
            for key, value in params.items() if key in NAMES
        })  # fmt: skip
        if "transl" not in rows[-1]:
            raise InputError(
                f"{where}: says no place of the person; expected trans or translation, metres in "
                "the camera's axes, which some forks leave out: out['cam_trans']"
            )
    return together(where, [{name: x[None] for name, x in row.items()} for row in rows])


def together(where: str, each: Sequence[Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Arrays of single frames as arrays of all of them, by the names that all have.

    Raises:
        InputError: one is not of the same shape in all of them.
    """
    names = set(each[0]).intersection(*each)
    for name in names:
        if len({x[name].shape for x in each}) > 1:
            raise InputError(f"{where}: '{name}' is not of one shape in all frames")
    return {name: np.concatenate([x[name] for x in each]) for name in names}


def pinhole_of(where: str, about: Mapping[str, Any]) -> np.ndarray:
    """K (3, 3) of a camera's ``focal`` and ``princpt``, or as a fork names them.

    Raises:
        InputError: it says neither.
    """
    try:
        (fx, fy), (cx, cy) = (
            about.get(short, about.get(long))
            for short, long in (("focal", "focal_length"), ("princpt", "principal_point"))
        )
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)
    except (TypeError, ValueError, AttributeError):
        raise InputError(f"{where}: expected {CAMERA}") from None


def _files(found: Any) -> list[Path]:  # noqa: ANN401
    """A folder's files of people: the fork's, those in ``smplx_param/``, or all."""
    if not isinstance(found, Path):
        return []
    forks = sorted(found.glob("**/person_*/smplx_params_person_*.json"))
    inner = found / "smplx_param"
    return forks or sorted((inner if inner.is_dir() else found).glob("*.json"))


def _frame_of(path: Path) -> int:
    """The frame of a file: of the folder of a fork's run, or of its name, without the person."""
    if path.name.startswith("smplx_params_person"):
        return last_number(path.parent.parent)
    match = _FRAME_PERSON.search(path.stem)
    try:
        return int(match[1]) if match else last_number(path)
    except ValueError:
        raise InputError(
            f"{path}: expected the number of a frame, such as 12.json or 12_0.json"
        ) from None


def _lens(path: Path, content: Mapping[str, Any]) -> np.ndarray:
    """K (3, 3) of a file, or of the one that says it beside."""
    if "cam_param" in content:
        return pinhole_of(str(path), content["cam_param"])
    beside = path.parent / _CAMERA
    if not beside.is_file():
        beside = path.parent.parent / "cam_params" / path.name
    return pinhole_of(str(beside), read_json(beside, CAMERA))
