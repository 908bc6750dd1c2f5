"""Open what pose estimators write: how each kind is recognised, and the people that it holds.

A reader yields a :class:`Person` each, with arrays under the file's own names (n, ...). What these
mean is said once for each estimator, in :mod:`.estimators`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.body.pose import SMPLX_FIELDS
from gva_mi.data.importers.fields import translation_name
from gva_mi.data.importers.lens import lens_of, pinhole_K
from gva_mi.data.importers.numbering import frame_numbers, number_in
from gva_mi.data.importers.people import follow
from gva_mi.data.importers.rotations import to_matrices
from gva_mi.data.importers.tracks import PELVIS
from gva_mi.errors import InputError
from gva_mi.pickles.reader import read_objects

# From the pelvis to the middle of the hips at rest, metres: BEV's translations are of the latter.
_TO_HIPS = np.array([0.0, -0.09, -0.01])
_SMPLERX = re.compile(r"(\d+)_(\d+)\.npz")  # frame, person
_ROMP = "results"  # the one key of ROMP's .npz
_PICKLED = (".pkl", ".pickle", ".npz", ".npy", ".pt")
_EXPECTED = "what a pose estimator wrote"


@dataclass(frozen=True)
class Person:
    """What a file says of one person, under the file's own names."""

    name: str  # the estimator's name of them
    frames: np.ndarray  # (n,) frame numbers
    arrays: Mapping[str, Any]  # (n, ...) each


Row = tuple[str, int, Mapping[str, Any]]  # person, frame, arrays of one frame


def stacked(where: object, rows: Iterable[Row]) -> list[Person]:
    """People of single frames; an array of one frame may have a leading axis of 1.

    Raises:
        InputError: an array is missing in some frames, or not of one shape.
    """
    people: dict[str, list[tuple[int, Mapping[str, Any]]]] = {}
    for person, frame, arrays in rows:
        people.setdefault(person, []).append((frame, arrays))
    found = []
    for person, seen in people.items():
        names = dict.fromkeys(name for _, arrays in seen for name in arrays)
        arrays = {name: [_of_frame(x[name]) for _, x in seen if name in x] for name in names}
        for name, values in arrays.items():
            if len(values) < len(seen) or len({x.shape for x in values}) > 1:
                raise InputError(f"{where}: '{name}' is not of one shape in all frames")
        frames = np.array([frame for frame, _ in seen])
        found.append(Person(person, frames, {k: np.stack(x) for k, x in arrays.items()}))
    return found


def _of_frame(value: Any) -> np.ndarray:  # noqa: ANN401
    array = np.asarray(value)
    return array[0] if array.ndim > 1 and len(array) == 1 else array


def followed(where: object, frames: Iterable[tuple[int, list]], place: str) -> list[Person]:
    """People whom a file does not name: who is nearest by ``place`` in the next frame goes on."""
    frames = list(frames)
    names = follow([[np.ravel(person[place]) for person in people] for _, people in frames])
    return stacked(where, (
        (name, number, person)
        for (number, people), row in zip(frames, names, strict=True)
        for name, person in zip(row, people, strict=True)
    ))  # fmt: skip


def plain(found: Any) -> Any:  # noqa: ANN401
    """Unwrap an array of one object, numpy's way to keep a dictionary.

    A ``.npz`` of one such array is read as a ``.npy`` of it, whatever its key; but not ROMP's,
    which is recognised by its key.
    """
    if isinstance(found, dict) and len(found) == 1:
        (key, value), *_ = found.items()
        inner = _one_object(value)
        if key == "arr_0" and isinstance(value, np.ndarray):  # numpy's own name for an unnamed one
            return inner
        return inner if isinstance(inner, dict) and inner is not value and key != _ROMP else found
    return _one_object(found)


def _one_object(found: Any) -> Any:  # noqa: ANN401
    one = isinstance(found, np.ndarray) and found.dtype.hasobject and found.size == 1
    return found.item() if one else found


def read_source(source: Path, expected: str = _EXPECTED) -> Any:  # noqa: ANN401
    """What a file holds; a folder as its path."""
    return source if source.is_dir() else plain(read_objects(source, expected))


def read_named(path: Path, expected: str) -> dict:
    """What a file holds by name.

    Raises:
        InputError: nothing by name.
    """
    found = read_source(path, expected)
    if not isinstance(found, dict):
        raise InputError(f"{path}: holds nothing by name; expected {expected}")
    return found


def files_in(found: Any, *patterns: str) -> list[Path]:  # noqa: ANN401
    """A folder's files by the first pattern that any fits, in the order of their names."""
    if isinstance(found, Path):
        for pattern in patterns or ("*",):
            if files := sorted(p for p in found.glob(pattern) if p.suffix in _PICKLED):
                return files
    return []


def first_of(found: Any) -> Any:  # noqa: ANN401
    """What a folder's first file holds; of a file, what it holds."""
    if not isinstance(found, Path):
        return found
    files = files_in(found)
    try:
        return read_source(files[0]) if files else None
    except InputError:
        return None


def holds(found: Any, *names: str) -> bool:  # noqa: ANN401
    """Whether a file holds all these names."""
    return isinstance(found, Mapping) and set(names) <= set(found)


def any_holds(found: Any, *names: str) -> bool:  # noqa: ANN401
    """Whether one of a file's people, or frames, has all these names."""
    whole = isinstance(found, dict) and all(isinstance(p, dict) for p in found.values())
    return whole and any(holds(person, *names) for person in found.values())


def wham(where: str, found: dict) -> Iterator[Person]:
    """A dictionary a person."""
    for name, person in found.items():
        ids = person["frame_ids" if "frame_ids" in person else "frame_id"]
        yield Person(str(name), frame_numbers(ids), person)


def wham_world(where: str, found: dict) -> Iterator[Person]:
    """People whom WHAM placed in the world; without numbers, their frames follow each other."""
    for name, person in found.items():
        if _is_placed(person):
            every = np.arange(len(person["pose_world"]))
            ids = person.get("frame_ids", person.get("frame_id", every))
            yield Person(str(name), frame_numbers(ids), person)


def is_wham_world(found: Any) -> bool:  # noqa: ANN401
    return isinstance(found, Mapping) and any(map(_is_placed, found.values()))


def _is_placed(person: Any) -> bool:  # noqa: ANN401
    return isinstance(person, Mapping) and person.get("pose_world") is not None


def phalp(where: str, found: dict) -> list[Person]:
    """A dictionary a frame, with lists of people."""
    rows = []
    for k, name in enumerate(sorted(found)):
        frame = found[name]
        number, tracked = int(frame.get("time", k)), frame.get("tracked_ids", frame["tid"])
        tracked = {int(i) for i in tracked}
        for person, smpl, camera in zip(frame["tid"], frame["smpl"], frame["camera"], strict=False):
            if int(person) in tracked:
                some = {key: smpl[key] for key in ("global_orient", "body_pose", "betas")}
                rows.append((str(int(person)), number, some | {"camera": camera}))
    return stacked(where, rows)


def pymafx(where: str, found: dict) -> Iterator[Person]:
    """Batches of parameters, of all people after one another."""
    frames = frame_numbers(found["frame_ids"])
    names = ("body_pose", "shape", "left_hand_pose", "right_hand_pose", "jaw_pose", "leye_pose",
             "reye_pose")  # fmt: skip
    arrays = {
        name: np.concatenate([np.asarray(batch[name]) for batch in found["smplx_params"]])
        for name in names
    } | {"orig_cam_t": np.asarray(found["orig_cam_t"])}
    for name, x in arrays.items():
        if len(x) != len(frames):
            raise InputError(f"{where}: '{name}' has {len(x)} rows for {len(frames)} frame_ids")
    people = [str(p) for p in np.ravel(found.get("person_ids", ()))]
    people = np.array(people if len(people) == len(frames) else ["0"] * len(frames))
    for name in dict.fromkeys(people.tolist()):
        rows = np.flatnonzero(people == name)
        yield Person(name, frames[rows], {key: x[rows] for key, x in arrays.items()})


def hybrik(where: str, found: dict) -> Iterator[Person]:
    """One person: matrices of SMPL's 24 joints or SMPL-X's 55, and a box a frame."""
    frames = np.array([number_in(name) for name in np.ravel(found["img_path"])])
    n = len(frames)
    shapes = {"pred_thetas": (n, -1, 3, 3), "pred_betas": (n, -1), "bbox": (n, 4)}
    arrays = {name: np.reshape(found[name], shape) for name, shape in shapes.items()}
    arrays |= {name: np.broadcast_to(np.ravel(found[name]), n) for name in ("width", "height")}
    yield Person("0", frames, arrays | {"pred_cam_root": found["pred_cam_root"]})


def tram_files(found: Any) -> list[Path]:  # noqa: ANN401
    return files_in(found, "hps/hps_track_*.npy", "hps_track_*.npy")


def tram_camera(found: Path) -> dict:
    """TRAM's lens, and by ``pred_cam_R`` and ``pred_cam_T`` its path; it lies above ``hps/``."""
    above = found if tram_files(found)[0].parent != found else found.parent
    return read_named(above / "camera.npy", "img_focal and img_center, as TRAM writes")


def tram(where: str, found: Path) -> Iterator[Person]:
    """A file a person."""
    about = tram_camera(found)
    K = pinhole_K(np.ravel(about["img_focal"])[0], about["img_center"])
    for path in tram_files(found):
        person = read_source(path, "pred_rotmat, pred_trans and frame, as TRAM writes")
        frames = frame_numbers(person["frame"])
        pose = np.reshape(person["pred_rotmat"], (len(frames), -1, 3, 3))
        yield Person(str(number_in(path)), frames, {**person, "pred_rotmat": pose, "K": K})


def romp(where: str, found: Any) -> list[Person]:  # noqa: ANN401
    """ROMP's and BEV's people, by their track ids; without these, who is nearest goes on."""
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
    """Number and result of each frame, by the first number of a picture's name."""
    if isinstance(found, dict):
        results = plain(found[_ROMP])
        if "smpl_thetas" in results:
            return [(0, results)]
        frames = ((number_in(name, 0), result) for name, result in results.items())
    elif (found / "video_results.npz").is_file():
        return _romp_frames(read_objects(found / "video_results.npz", "ROMP's results of a video"))
    else:
        read = lambda path: plain(read_objects(path, "ROMP's results of a frame")[_ROMP])
        frames = ((number_in(path, 0), read(path)) for path in files_in(found, "*.npz"))
    return sorted(frames, key=lambda frame: frame[0])


def is_romp(found: Any) -> bool:  # noqa: ANN401
    first = first_of(found)
    return isinstance(first, dict) and isinstance(plain(first.get(_ROMP)), dict)


def _humans(found: Any) -> list[dict]:  # noqa: ANN401
    """The people of a frame: a list of dictionaries, or one of them."""
    if isinstance(found, np.ndarray) and found.dtype.hasobject:
        found = found.ravel().tolist()
    found = [found] if isinstance(found, dict) else found
    whole = isinstance(found, list) and all(isinstance(person, dict) for person in found)
    return found if whole else []


def is_multihmr(found: Any) -> bool:  # noqa: ANN401
    people = _humans(first_of(found))
    return bool(people) and holds(people[0], "rotvec", "transl_pelvis")


def multihmr(where: str, found: Path) -> list[Person]:
    """A list of people a frame."""
    names = ("rotvec", "transl_pelvis", "shape")
    read = lambda path: [
        {name: person[name] for name in names}
        for person in _humans(read_source(path, "the people of a frame"))
    ]
    frames = sorted(((number_in(path), read(path)) for path in files_in(found)), key=lambda f: f[0])
    return followed(where, (frame for frame in frames if frame[1]), "transl_pelvis")


def _smplifyx_files(found: Any) -> list[Path]:  # noqa: ANN401
    return files_in(found, "results/*/*.pkl", "*/*.pkl")


def is_smplifyx(found: Any) -> bool:  # noqa: ANN401
    paths = _smplifyx_files(found)
    return bool(paths) and holds(read_source(paths[0]), "camera_translation")


def smplifyx(where: str, found: Path) -> list[Person]:
    """A folder a picture and a file a person."""
    names = (*SMPLX_FIELDS, "betas", "camera_translation")
    return stacked(found, (
        (path.stem, number_in(path.parent.name), _some(path, names))
        for path in _smplifyx_files(found)
    ))  # fmt: skip


def smplerx_files(found: Any) -> list[tuple[str, int, Path]]:  # noqa: ANN401
    """Person, frame and file of each ``smplx/00001_0.npz``."""
    inner = isinstance(found, Path) and (found / "smplx").is_dir()
    files = files_in(found / "smplx" if inner else found, "*.npz")
    matches = ((path, _SMPLERX.fullmatch(path.name)) for path in files)
    return [(match[2], int(match[1]), path) for path, match in matches if match]


def smplerx(where: str, found: Path) -> list[Person]:
    """A file a frame and person, and its lens in a file of the same name in ``meta/``."""
    lens = lambda path: path.parent.parent / "meta" / path.with_suffix(".json").name
    names = (*SMPLX_FIELDS, "transl", "betas")
    return stacked(found, (
        (person, frame, _some(path, names) | {"K": lens_of(lens(path))})
        for person, frame, path in smplerx_files(found)
    ))  # fmt: skip


def _some(path: Path, names: tuple[str, ...]) -> dict[str, Any]:
    found = read_named(path, "SMPL-X's parameters of one frame")
    return {name: found[name] for name in names if name in found}


def is_parameters(found: Any) -> bool:  # noqa: ANN401
    first = first_of(found)
    return any(holds(first, name) for name in ("body_pose", "poses", "thetas", "fullpose"))


def parameters(where: str, found: Any) -> Iterator[Person]:  # noqa: ANN401
    """One person in a file, or in a file a frame, by the names of :mod:`.fields`."""
    if isinstance(found, dict):
        if (name := translation_name(found)) is None:
            raise InputError(f"{where}: holds no translation; expected transl (T, 3) in the camera")
        yield Person("0", np.arange(np.size(found[name]) // 3), found)
        return
    files = sorted(files_in(found), key=number_in)
    each = [read_named(path, "a body's parameters by name") for path in files]
    numbers = [k for k, x in each[0].items() if np.asarray(x).dtype.kind in "fiu"]
    rows = ({k: frame[k] for k in numbers if k in frame} for frame in each)
    yield from stacked(
        found, (("0", number_in(p), row) for p, row in zip(files, rows, strict=True))
    )
