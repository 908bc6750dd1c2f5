"""Recognise and open the files of pose estimators, and yield the people in them.

Each reader yields one :class:`SeenPerson` a person, with arrays (n, ...) under the file's own
names. :mod:`.estimators` says what they mean.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.core.errors import InputError
from gva_mi.core.pickles.reader import read_objects
from gva_mi.data.importers.lens import pinhole_K
from gva_mi.data.importers.numbering import frame_numbers, frames_named, number_in
from gva_mi.data.importers.one_lens import seen_alike, usual_lens
from gva_mi.data.importers.people import follow
from gva_mi.data.importers.spellings import holds_pose, unnested

ROMP = "results"  # the one key of ROMP's .npz
_PICKLED = (".pkl", ".pickle", ".npz", ".npy", ".pt")
_EXPECTED = "what a pose estimator wrote"


@dataclass(frozen=True)
class SeenPerson:
    """One person's arrays in a file, under the file's own names."""

    name: str  # the estimator's name of them
    frames: np.ndarray | None  # (n,) frame numbers; None: 0 to n − 1
    arrays: Mapping[str, Any]  # (n, ...) each


Row = tuple[str, int, Mapping[str, Any]]  # person, frame, arrays of one frame


def stacked(where: object, rows: Iterable[Row]) -> list[SeenPerson]:
    """Stack single frames to people; an array of one frame may have a leading axis of 1."""
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
        found.append(SeenPerson(person, frames, {k: np.stack(x) for k, x in arrays.items()}))
    return found


def _of_frame(value: Any) -> np.ndarray:  # noqa: ANN401
    array = np.asarray(value)
    return array[0] if array.ndim > 1 and len(array) == 1 else array


def followed(where: object, frames: Iterable[tuple[int, list]], place: str) -> list[SeenPerson]:
    """Track people without ids: each continues as the nearest, by ``place``, in the next frame.

    People with a lens of their own, K, are compared before one: :mod:`.one_lens`.
    """
    frames = list(frames)
    everyone = [person for _, people in frames for person in people]
    places = np.array([np.ravel(person[place]) for person in everyone]).reshape(-1, 3)
    if everyone and "K" in everyone[0]:
        K = np.stack([person["K"] for person in everyone])
        places = seen_alike(places, K, usual_lens(K))
    ends = np.cumsum([len(people) for _, people in frames])[:-1]
    names = follow(np.split(places, ends))
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
        return inner if isinstance(inner, dict) and inner is not value and key != ROMP else found
    return _one_object(found)


def _one_object(found: Any) -> Any:  # noqa: ANN401
    one = isinstance(found, np.ndarray) and found.dtype.hasobject and found.size == 1
    return found.item() if one else found


def read_source(source: Path, expected: str = _EXPECTED) -> Any:  # noqa: ANN401
    """Read a file's content; for a folder, return its path."""
    return source if source.is_dir() else _joined(source, plain(read_objects(source, expected)))


def _joined(source: Path, found: Any) -> Any:  # noqa: ANN401
    """Return the arrays of all frames of a list with a body's parameters a frame."""
    rows = found.tolist() if isinstance(found, np.ndarray) and found.dtype.hasobject else found
    rows = [unnested(x) for x in rows] if isinstance(rows, list) else []
    if not rows or not all(map(holds_pose, rows)):
        return found
    rows = [{k: x for k, x in row.items() if np.asarray(x).dtype.kind in "biuf"} for row in rows]
    (person,) = stacked(source, (("0", k, row) for k, row in enumerate(rows)))
    return dict(person.arrays)


def read_named(path: Path, expected: str) -> dict:
    """Read a file's content as a dictionary."""
    found = read_source(path, expected)
    if not isinstance(found, dict):
        raise InputError(f"{path}: holds nothing by name; expected {expected}")
    return found


def files_in(found: Any, *patterns: str) -> list[Path]:  # noqa: ANN401
    """Return a folder's files, sorted by name, of the first pattern that matches any file."""
    if isinstance(found, Path):
        for pattern in patterns or ("*",):
            if files := sorted(p for p in found.glob(pattern) if p.suffix in _PICKLED):
                return files
    return []


def first_of(found: Any) -> Any:  # noqa: ANN401
    """Return the content of a folder's first file, or of a file that is already read."""
    if not isinstance(found, Path):
        return found
    files = files_in(found)
    try:
        return read_source(files[0]) if files else None
    except InputError:
        return None


def holds(found: Any, *names: str) -> bool:  # noqa: ANN401
    """Whether a file's content has all these names."""
    return isinstance(found, Mapping) and set(names) <= set(found)


def any_holds(found: Any, *names: str) -> bool:  # noqa: ANN401
    """Whether one of a file's people, or frames, has all these names."""
    whole = isinstance(found, dict) and all(isinstance(p, dict) for p in found.values())
    return whole and any(holds(person, *names) for person in found.values())


def wham(where: str, found: dict) -> Iterator[SeenPerson]:
    """Read WHAM's file: one dictionary per person."""
    for name, person in found.items():
        ids = person["frame_ids" if "frame_ids" in person else "frame_id"]
        yield SeenPerson(str(name), frame_numbers(ids), person)


def wham_world(where: str, found: dict) -> Iterator[SeenPerson]:
    """Read WHAM's people in world axes; frames without numbers are consecutive."""
    for name, person in found.items():
        if _is_placed(person):
            every = np.arange(len(person["pose_world"]))
            ids = person.get("frame_ids", person.get("frame_id", every))
            yield SeenPerson(str(name), frame_numbers(ids), person)


def is_wham_world(found: Any) -> bool:  # noqa: ANN401
    return isinstance(found, Mapping) and any(map(_is_placed, found.values()))


def _is_placed(person: Any) -> bool:  # noqa: ANN401
    return isinstance(person, Mapping) and person.get("pose_world") is not None


def phalp(where: str, found: dict) -> list[SeenPerson]:
    """Read PHALP's (4D-Humans') file: one dictionary per frame, with lists of people."""
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


def pymafx(where: str, found: dict) -> Iterator[SeenPerson]:
    """Read PyMAF-X's batches of parameters; all people follow one another."""
    frames = frame_numbers(found["frame_ids"])
    names = ("body_pose", "shape", "left_hand_pose", "right_hand_pose", "jaw_pose", "leye_pose",
             "reye_pose", "expression")  # fmt: skip
    arrays = {
        name: np.concatenate([np.asarray(batch[name]) for batch in found["smplx_params"]])
        for name in names
        if all(name in batch for batch in found["smplx_params"])
    } | {"orig_cam_t": np.asarray(found["orig_cam_t"])}
    for name, x in arrays.items():
        if len(x) != len(frames):
            raise InputError(f"{where}: '{name}' has {len(x)} rows for {len(frames)} frame_ids")
    people = [str(p) for p in np.ravel(found.get("person_ids", ()))]
    people = np.array(people if len(people) == len(frames) else ["0"] * len(frames))
    for name in dict.fromkeys(people.tolist()):
        rows = np.flatnonzero(people == name)
        yield SeenPerson(name, frames[rows], {key: x[rows] for key, x in arrays.items()})


def hybrik(where: str, found: dict) -> Iterator[SeenPerson]:
    """Read HybrIK's person: matrices of SMPL's 24 joints or SMPL-X's 55, and a box per frame."""
    frames = frames_named(np.ravel(found["img_path"]))
    n = len(frames)
    shapes = {"pred_thetas": (n, -1, 3, 3), "pred_betas": (n, -1), "bbox": (n, 4)}
    arrays = {name: np.reshape(found[name], shape) for name, shape in shapes.items()}
    arrays |= {name: np.broadcast_to(np.ravel(found[name]), n) for name in ("width", "height")}
    yield SeenPerson("0", frames, arrays | {"pred_cam_root": found["pred_cam_root"]})


def tram_files(found: Any) -> list[Path]:  # noqa: ANN401
    return files_in(found, "hps/hps_track_*.npy", "hps_track_*.npy")


def tram_camera(found: Path) -> dict:
    """Read TRAM's lens and camera path (``pred_cam_R``, ``pred_cam_T``) from above ``hps/``."""
    above = found if tram_files(found)[0].parent != found else found.parent
    return read_named(above / "camera.npy", "img_focal and img_center, as TRAM writes")


def tram(where: str, found: Path) -> Iterator[SeenPerson]:
    """Read TRAM's folder: one file per person."""
    about = tram_camera(found)
    K = pinhole_K(np.ravel(about["img_focal"])[0], about["img_center"])
    for path in tram_files(found):
        person = read_source(path, "pred_rotmat, pred_trans and frame, as TRAM writes")
        frames = frame_numbers(person["frame"])
        pose = np.reshape(person["pred_rotmat"], (len(frames), -1, 3, 3))
        yield SeenPerson(str(number_in(path)), frames, {**person, "pred_rotmat": pose, "K": K})
