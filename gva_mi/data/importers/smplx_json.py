"""Read SMPL-X parameters in JSON, one file per frame: OSX, NeuralAnnot, ExAvatar, SMPLest-X forks.

===================  =================================================  =======================
Written by           Names                                              Camera
===================  =================================================  =======================
NeuralAnnot, OSX     ``smplx_param`` with ``root_pose``,                ``cam_param``
                     ``body_pose``, ``lhand_pose``, ``rhand_pose``,
                     ``jaw_pose``, ``shape``, ``expr``, ``trans``
ExAvatar             these without ``smplx_param``                      ``cam_params/12.json``
forks of SMPLest-X   the same with ``left_hand_pose``,                  ``camera_metadata.json``
                     ``right_hand_pose``, ``betas``, ``translation``    beside
===================  =================================================  =======================

OSX's own demo and SMPLest-X's own inference keep pictures and meshes, and no parameters. All add
the mean hand to the fingers, as the package smplx does by default.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.core.errors import InputError
from gva_mi.core.files import read_json
from gva_mi.data.importers.estimator_files import SeenPerson, followed
from gva_mi.data.importers.lens import lens_in, lens_of
from gva_mi.data.importers.numbering import number_in
from gva_mi.data.importers.spellings import SPELLINGS, plain_name

NAMES = {name for names in SPELLINGS.values() for name in names}
_EXPECTED = "SMPL-X's parameters of a frame (.json)"
_FRAME_PERSON = re.compile(r"(?:^|_)(\d+)_(?:person_?)?\d+$")


def is_osx(found: Any) -> bool:  # noqa: ANN401
    files = _files(found)
    first = read_json(files[0], _EXPECTED) if files else None
    params = first.get("smplx_param", first) if isinstance(first, dict) else None
    return isinstance(params, dict) and {"root_pose", "body_pose"} <= set(map(plain_name, params))


def osx(where: str, found: Path) -> list[SeenPerson]:
    """Read OSX's people, which are renumbered in each frame; track the nearest person."""
    frames: dict[int, list[dict[str, np.ndarray]]] = {}
    for path in _files(found):
        content, people = read_json(path, _EXPECTED), frames.setdefault(_frame_of(path), [])
        person = parameters(path, content.get("smplx_param", content)) | {"K": _lens(path, content)}
        people.append(person)
    return followed(where, sorted(frames.items()), "transl")


def parameters(where: Path, params: Mapping[str, Any] | None = None) -> dict[str, np.ndarray]:
    """Return a frame's parameters, flat, with its place as ``transl``; by default a file's own."""
    params = read_json(where, _EXPECTED) if params is None else params
    row = {
        plain_name(key): np.ravel(np.asarray(value, np.float64))
        for key, value in params.items() if plain_name(key) in NAMES
    }  # fmt: skip
    place = next((name for name in SPELLINGS["transl"] if name in row), None)
    if place is None:
        raise InputError(
            f"{where}: says no place of the person; expected trans or translation, metres in the "
            "camera's axes, which some forks leave out: out['cam_trans']"
        )
    return row | {"transl": row.pop(place)}


def _files(found: Any) -> list[Path]:  # noqa: ANN401
    """Return a folder's files of people: a fork's, those in ``smplx_param/``, or all."""
    if not isinstance(found, Path):
        return []
    forks = sorted(found.glob("**/person_*/smplx_params_person_*.json"))
    inner = found / "smplx_param"
    return forks or sorted((inner if inner.is_dir() else found).glob("*.json"))


def _frame_of(path: Path) -> int:
    """Return the frame number in a fork's run folder, or in a file name without the person."""
    if path.name.startswith("smplx_params_person"):
        return number_in(path.parent.parent)
    match = _FRAME_PERSON.search(path.stem)
    try:
        return int(match[1]) if match else number_in(path)
    except ValueError:
        raise InputError(
            f"{path}: expected the number of a frame, such as 12.json or 12_0.json"
        ) from None


def _lens(path: Path, content: Mapping[str, Any]) -> np.ndarray:
    """Return K (3, 3) in a file, or in the file beside it."""
    if "cam_param" in content:
        return lens_in(path, content["cam_param"])
    beside = path.parent / "camera_metadata.json"
    return lens_of(beside if beside.is_file() else path.parent.parent / "cam_params" / path.name)
