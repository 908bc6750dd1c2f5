"""Read estimators that write a folder with a file for each frame."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.body.pose import SMPLX_FIELDS
from gva_mi.body.rotations import to_matrices
from gva_mi.core.errors import InputError
from gva_mi.core.pickles.reader import read_objects
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
from gva_mi.data.importers.lens import lens_of
from gva_mi.data.importers.numbering import frames_named
from gva_mi.data.importers.spellings import NamedArrays, holds_pose, unnested
from gva_mi.data.importers.target import PELVIS

# From the pelvis to the middle of the hips at rest, metres: BEV's translations are of the latter.
_TO_HIPS = np.array([0.0, -0.09, -0.01])
_NAME = re.compile(r"(\d+)_(\d+)\.npz")  # frame and person of SMPLer-X
_OF_BEV = re.compile(r"__\d+_[\d.]+$")  # what BEV adds to a picture's name
_SMPLX = (*SMPLX_FIELDS, "betas", "expression")


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
        people = followed(where, ((number, each(r)) for number, r in frames), "cam_trans")
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
    names = ("rotvec", "transl_pelvis", "shape", "expression")
    read = lambda path: [
        {name: person[name] for name in names if name in person}
        for person in _humans(read_source(path, "the people of a frame"))
    ]
    files = files_in(found)
    numbers = frames_named(files).tolist()
    frames = sorted(zip(numbers, map(read, files), strict=True), key=lambda f: f[0])
    return followed(where, (frame for frame in frames if frame[1]), "transl_pelvis")


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
        (path.stem, number, _some(path, (*_SMPLX, "camera_translation")))
        for number, path in zip(numbers, files, strict=True)
    ))  # fmt: skip


def smplerx_files(found: Any) -> list[tuple[str, int, Path]]:  # noqa: ANN401
    """Return person, frame and file of each ``smplx/00001_0.npz``."""
    inner = isinstance(found, Path) and (found / "smplx").is_dir()
    files = files_in(found / "smplx" if inner else found, "*.npz")
    matches = ((path, _NAME.fullmatch(path.name)) for path in files)
    return [(match[2], int(match[1]), path) for path, match in matches if match]


def smplerx(where: str, found: Path) -> list[SeenPerson]:
    """Read SMPLer-X's files: one per frame and person, the lens under that name in ``meta/``.

    It numbers the people of each frame anew, in the order of its detector.
    """
    lens = lambda path: path.parent.parent / "meta" / path.with_suffix(".json").name
    frames: dict[int, list] = {}
    for _, frame, path in sorted(smplerx_files(found)):
        person = _some(path, (*_SMPLX, "transl")) | {"K": lens_of(lens(path))}
        frames.setdefault(frame, []).append(person)
    return followed(where, sorted(frames.items()), "transl")


def _some(path: Path, names: tuple[str, ...]) -> dict[str, Any]:
    found = read_named(path, "SMPL-X's parameters of one frame")
    return {name: found[name] for name in names if name in found}


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
