"""Open the files of pose estimators, look what they hold, and join frames to people.

Readers (:mod:`.people_files`, :mod:`.frame_files`) yield one :class:`SeenPerson` a person, with
arrays (n, ...) under the file's own names. :mod:`.estimators` says what they mean.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.core.errors import InputError
from gva_mi.core.pickles import read_objects
from gva_mi.data.importers.numbering import frames_named
from gva_mi.data.importers.one_lens import seen_alike, usual_lens
from gva_mi.data.importers.people import follow
from gva_mi.data.importers.spellings import holds_pose, one_object, unnested

ROMP = "results"  # the one key of ROMP's .npz
_PICKLED = (".pkl", ".pickle", ".npz", ".npy", ".pt")
_EXPECTED = "what a pose estimator wrote"
_OF_MHR = {"mhr_model_params", "mhr_shape_params", "body_pose_params"}
_PICTURE = re.compile(r"\d\D*\.(png|jpe?g|bmp|webp)$", re.I)  # a numbered one


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


def followed(
    where: object, seen: Iterable[tuple[int, Mapping[str, Any]]], place: str
) -> list[SeenPerson]:
    """Track people without ids: each continues as the nearest, by ``place``, in the next frame.

    ``seen`` are frame and arrays of each person in any order of frames. People with a lens of their
    own, K, are compared before one: :mod:`.one_lens`.
    """
    by_frame: dict[int, list] = {}
    for number, person in seen:
        by_frame.setdefault(number, []).append(person)
    frames = sorted(by_frame.items())
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
    """Unwrap an array of one object.

    A ``.npz`` of one such array is read as a ``.npy`` of it, whatever its key; but not ROMP's,
    which is recognised by its key.
    """
    if isinstance(found, dict) and len(found) == 1:
        (key, value), *_ = found.items()
        inner = one_object(value)
        if key == "arr_0" and isinstance(value, np.ndarray):  # numpy's own name for an unnamed one
            return inner
        return inner if isinstance(inner, dict) and inner is not value and key != ROMP else found
    return one_object(found)


def read_source(source: Path, expected: str = _EXPECTED) -> Any:  # noqa: ANN401
    """Read a file's content; for a folder, return its path."""
    return source if source.is_dir() else _joined(source, plain(read_objects(source, expected)))


def _joined(source: Path, found: Any) -> Any:  # noqa: ANN401
    """Return the arrays of all frames of a list with a body's parameters a frame.

    A dictionary by the names of consecutive pictures is such a list.
    """
    rows = found.tolist() if isinstance(found, np.ndarray) and found.dtype.hasobject else found
    if isinstance(rows, dict) and rows and all(_PICTURE.search(str(name)) for name in rows):
        numbers = frames_named(list(rows)).tolist()
        in_order = [row for _, row in sorted(zip(numbers, rows.values(), strict=True),
                                             key=lambda pair: pair[0])]  # fmt: skip
        rows = in_order if np.ptp(numbers) == len(set(numbers)) - 1 == len(rows) - 1 else None
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


def refuse_mhr(where: object, found: Any, deep: int = 4) -> None:  # noqa: ANN401
    """Refuse by name the parameters of MHR, the body of SAM 3D Body, however deep they lie."""
    if isinstance(found, np.ndarray):
        found = found.ravel()[:20].tolist() if found.dtype.hasobject else ()
    if isinstance(found, Mapping) and _OF_MHR & set(map(str, found)):
        raise InputError(
            f"{where}: holds parameters of MHR, as SAM 3D Body writes, which is another body than "
            "SMPL-X; convert_sam3d_output_to_smplx of tools/mhr_smpl_conversion in MHR's "
            "repository, not in its pip package, fits SMPL-X to it: save its result_parameters by "
            "name (.npz)"
        )
    if deep and isinstance(found, Mapping | list | tuple):
        inner = found.values() if isinstance(found, Mapping) else found
        for value in list(inner)[:20]:  # frames are alike
            refuse_mhr(where, value, deep - 1)
