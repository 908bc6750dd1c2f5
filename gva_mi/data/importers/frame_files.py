"""Read estimators that write a folder with a file for each frame.

Of SMPL-X's parameters in JSON there are

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
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.body.pose import SMPLX_FIELDS
from gva_mi.body.rotations import to_matrices
from gva_mi.core.errors import InputError
from gva_mi.core.files import read_json
from gva_mi.core.pickles import read_objects
from gva_mi.data.importers.estimator_files import (
    ROMP,
    SeenPerson,
    files_in,
    first_of,
    followed,
    holds,
    plain,
    read_named,
    read_source,
    stacked,
)
from gva_mi.data.importers.lens import lens_in, lens_of
from gva_mi.data.importers.numbering import frames_named, number_in
from gva_mi.data.importers.spellings import (
    SPELLINGS,
    NamedArrays,
    holds_pose,
    plain_name,
    unnested,
)
from gva_mi.data.importers.target import PELVIS

# From the pelvis to the middle of the hips at rest, metres: BEV's translations are of the latter.
_TO_HIPS = np.array([0.0, -0.09, -0.01])
_OF_BEV = re.compile(r"__\d+_[\d.]+$")  # what BEV adds to a picture's name
_OF_SMPLERX = re.compile(r"(\d+)_(\d+)\.npz")  # frame and person
_OF_OSX = re.compile(r"(?:^|_)(\d+)_(?:person_?)?\d+$")  # frame and person
_SMPLX = (*SMPLX_FIELDS, "betas", "expression")
_SPELLED = {name for names in SPELLINGS.values() for name in names}
_JSON = "SMPL-X's parameters of a frame (.json)"


def romp(where: str, found: Any) -> list[SeenPerson]:  # noqa: ANN401
    """Read ROMP's and BEV's people by track id; without ids, track the nearest person."""
    frames = [(number, r) for number, r in _romp_frames(found) if len(r["smpl_thetas"])]
    each = lambda r: [
        {key: r[key][k] for key in ("smpl_thetas", "smpl_betas", "cam_trans")}
        for k in range(len(r["smpl_thetas"]))
    ]
    if all("track_ids" in r for _, r in frames):
        people = stacked(where, (
            (str(name), number, person)
            for number, r in frames
            for name, person in zip(np.ravel(r["track_ids"]), each(r), strict=True)
        ))  # fmt: skip
    else:
        seen = ((number, person) for number, r in frames for person in each(r))
        people = followed(where, seen, "cam_trans")
    for person in people:
        x = person.arrays
        if x["smpl_betas"].shape[1] == 11:  # BEV, whose place is that of the hips
            R = to_matrices(x["smpl_thetas"][:, :3])
            x["cam_trans"] = x["cam_trans"] - R @ _TO_HIPS - np.array(PELVIS["SMPL"])
        x["smpl_betas"] = x["smpl_betas"][:, :10]
    return people


def _romp_frames(found: Any) -> list[tuple[int, dict]]:  # noqa: ANN401
    """Return number and result of each frame."""
    if isinstance(found, dict):
        results = plain(found[ROMP])
        if "smpl_thetas" in results:
            return [(0, results)]
        named = {Path(str(name)).stem: result for name, result in results.items()}
    elif (found / "video_results.npz").is_file():
        return _romp_frames(read_objects(found / "video_results.npz", "ROMP's results of a video"))
    else:
        read = lambda path: plain(read_objects(path, "ROMP's results of a frame")[ROMP])
        named = {path.stem: read(path) for path in files_in(found, "*.npz")}
    numbers = frames_named([_OF_BEV.sub("", name) for name in named]).tolist()
    return sorted(zip(numbers, named.values(), strict=True), key=lambda frame: frame[0])


def is_romp(found: Any) -> bool:  # noqa: ANN401
    first = first_of(found)
    return isinstance(first, dict) and isinstance(plain(first.get(ROMP)), dict)


def _humans(found: Any) -> list[dict]:  # noqa: ANN401
    """Return the people of a frame, given as a list of dictionaries or a single one."""
    if isinstance(found, np.ndarray) and found.dtype.hasobject:
        found = found.ravel().tolist()
    found = [found] if isinstance(found, dict) else found
    whole = isinstance(found, list) and all(isinstance(person, dict) for person in found)
    return found if whole else []


def is_multihmr(found: Any) -> bool:  # noqa: ANN401
    people = _humans(first_of(found))
    return bool(people) and holds(people[0], "rotvec", "transl_pelvis")


def multihmr(where: str, found: Path) -> list[SeenPerson]:
    """Read Multi-HMR's files: a list of people per frame."""
    names, files = ("rotvec", "transl_pelvis", "shape", "expression"), files_in(found)
    seen = (
        (number, {name: person[name] for name in names if name in person})
        for path, number in zip(files, frames_named(files).tolist(), strict=True)
        for person in _humans(read_source(path, "the people of a frame"))
    )
    return followed(where, seen, "transl_pelvis")


def _smplifyx_files(found: Any) -> list[Path]:  # noqa: ANN401
    return files_in(found, "results/*/*.pkl", "*/*.pkl")


def is_smplifyx(found: Any) -> bool:  # noqa: ANN401
    paths = _smplifyx_files(found)
    return bool(paths) and holds(read_source(paths[0]), "camera_translation")


def smplifyx(where: str, found: Path) -> list[SeenPerson]:
    """Read SMPLify-X's output: a folder per picture and a file per person."""
    files = _smplifyx_files(found)
    numbers = frames_named([path.parent.name for path in files]).tolist()
    return stacked(found, (
        (path.stem, number, _some(path, "camera_translation"))
        for number, path in zip(numbers, files, strict=True)
    ))  # fmt: skip


def smplerx_files(found: Any) -> list[tuple[str, int, Path]]:  # noqa: ANN401
    """Return person, frame and file of each ``smplx/00001_0.npz``."""
    inner = isinstance(found, Path) and (found / "smplx").is_dir()
    files = files_in(found / "smplx" if inner else found, "*.npz")
    matches = ((path, _OF_SMPLERX.fullmatch(path.name)) for path in files)
    return [(match[2], int(match[1]), path) for path, match in matches if match]


def smplerx(where: str, found: Path) -> list[SeenPerson]:
    """Read SMPLer-X's files: one per frame and person, the lens under that name in ``meta/``.

    It numbers the people of each frame anew, in the order of its detector.
    """
    lens = lambda path: lens_of(path.parent.parent / "meta" / path.with_suffix(".json").name)
    seen = (
        (frame, _some(path, "transl") | {"K": lens(path)})
        for _, frame, path in sorted(smplerx_files(found))
    )
    return followed(where, seen, "transl")


def _some(path: Path, place: str) -> dict[str, Any]:
    """Return a file's parameters of SMPL-X and its place."""
    found = read_named(path, "SMPL-X's parameters of one frame")
    return {name: found[name] for name in (*_SMPLX, place) if name in found}


def is_osx(found: Any) -> bool:  # noqa: ANN401
    files = _osx_files(found)
    first = read_json(files[0], _JSON) if files else None
    params = first.get("smplx_param", first) if isinstance(first, dict) else None
    return isinstance(params, dict) and {"root_pose", "body_pose"} <= set(map(plain_name, params))


def osx(where: str, found: Path) -> list[SeenPerson]:
    """Read OSX's people, which are renumbered in each frame; track the nearest person."""

    def one(path: Path) -> tuple[int, Mapping[str, Any]]:
        content, frame = read_json(path, _JSON), _osx_frame(path)
        return frame, osx_parameters(path, content) | {"K": _osx_lens(path, content)}

    return followed(where, map(one, _osx_files(found)), "transl")


def osx_parameters(path: Path, content: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """Return the parameters in a file of one frame, flat, with its place as ``transl``."""
    row = {
        plain_name(key): np.ravel(np.asarray(value, np.float64))
        for key, value in content.get("smplx_param", content).items()
        if plain_name(key) in _SPELLED
    }
    place = next((name for name in SPELLINGS["transl"] if name in row), None)
    if place is None:
        raise InputError(
            f"{path}: says no place of the person; expected trans or translation, metres in the "
            "camera's axes, which some forks leave out: out['cam_trans']"
        )
    return row | {"transl": row.pop(place)}


def _osx_files(found: Any) -> list[Path]:  # noqa: ANN401
    """Return a folder's files of people: a fork's, those in ``smplx_param/``, or all."""
    if not isinstance(found, Path):
        return []
    forks = sorted(found.glob("**/person_*/smplx_params_person_*.json"))
    inner = found / "smplx_param"
    return forks or sorted((inner if inner.is_dir() else found).glob("*.json"))


def _osx_frame(path: Path) -> int:
    """Return the frame number in a fork's run folder, or in a file name without the person."""
    if path.name.startswith("smplx_params_person"):
        return number_in(path.parent.parent)
    match = _OF_OSX.search(path.stem)
    try:
        return int(match[1]) if match else number_in(path)
    except ValueError:
        raise InputError(
            f"{path}: expected the number of a frame, such as 12.json or 12_0.json"
        ) from None


def _osx_lens(path: Path, content: Mapping[str, Any]) -> np.ndarray:
    """Return K (3, 3) in a file, or in the file beside it."""
    if "cam_param" in content:
        return lens_in(path, content["cam_param"])
    beside = path.parent / "camera_metadata.json"
    return lens_of(beside if beside.is_file() else path.parent.parent / "cam_params" / path.name)


def is_parameters(found: Any) -> bool:  # noqa: ANN401
    return holds_pose(unnested(first_of(found)))


def parameters(where: str, found: Any) -> Iterator[SeenPerson]:  # noqa: ANN401
    """Read one person from a file, or from one file per frame, by :mod:`.spellings`."""
    if isinstance(found, dict):
        found = unnested(found)
        if not NamedArrays(where, found).holds("transl"):
            raise InputError(f"{where}: holds no translation; expected transl (T, 3) in the camera")
        yield SeenPerson("0", None, found)
        return
    files = files_in(found)
    each = [unnested(read_named(path, "a body's parameters by name")) for path in files]
    numbers = [k for k, x in each[0].items() if np.asarray(x).dtype.kind in "fiu"]
    rows = [{k: frame[k] for k in numbers if k in frame} for frame in each]
    frames = frames_named(files).tolist()
    yield from stacked(found, (("0", k, row) for k, row in zip(frames, rows, strict=True)))
