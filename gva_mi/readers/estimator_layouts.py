"""How estimators' files hold people, and the lens that each program assumes.

Each row of the table in :mod:`.estimators` has one function of each group.

- **People**, ``(where, found) -> People``: ``found`` is a file's content, or a folder's path, and
  ``where`` names it in errors. The arrays of a person keep the file's names.
- **Lenses**, ``(where, arrays, info) -> K``: the camera matrix (3, 3), or (n, 3, 3) for the frames
of
  a person, pixels of the video.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.body.pose import SMPLX_FIELDS
from gva_mi.body.rotations import to_matrices
from gva_mi.core.errors import InputError, expecting
from gva_mi.core.files import read_json
from gva_mi.readers.body_arrays import (
    ALL_JOINTS_NAMES,
    ARRAY_NAMES,
    NamedArrays,
    find_body,
    one_object,
    posed_parts,
    unnested,
)
from gva_mi.readers.people import Arrays, Row, SeenPerson, followed, stacked
from gva_mi.readers.source_files import files_in, first_of, holds, read_named
from gva_mi.readers.target_body import MEAN_PELVIS, TargetBody
from gva_mi.subject.footage import frame_numbers, frames_named, numbers_in
from gva_mi.subject.lens import EXPECTED_CAMERA, centred, pinhole_K, rescaled

People = Iterable[SeenPerson]

_BEV_SUFFIX = re.compile(r"__\d+_[\d.]+$")  # what BEV adds to a picture's name
_SMPLERX_FILE = re.compile(r"(\d+)_(\d+)\.npz")  # frame and person
_SMPLX_NAMES = (*SMPLX_FIELDS, "transl", "betas", "expression")
# Metres from the pelvis to the middle of the hips, at rest: BEV's translations are of the latter.
_PELVIS_TO_HIPS = np.array([0.0, -0.09, -0.01])
# The lenses, as the code of each program has them: focal length over side, pixels.
_HMR_FOCAL = 5000 / 256  # 4D-Humans: of the picture's longer side
_HYBRIK_FOCAL = 1000 / 256  # HybrIK: of the side of the person's box
_ROMP_FOCAL = 443.4 / 512  # ROMP: of the longer side


@dataclass(frozen=True)
class VideoInfo:
    """Facts about the video that a reader needs besides the file."""

    size: tuple[int, int]  # (W, H) of the video, pixels
    focal: float | None = None  # pixels, where the file says none
    body: TargetBody | None = None  # that poses are converted to
    is_known: bool = True  # False: there is no video, and ``size`` is any


def person_under(name: str) -> Callable[[str, dict], People]:
    """Return a reader of one person, whose arrays lie under ``name``; K is GVHMR's."""
    return lambda where, found: [
        SeenPerson("0", None, {**found[name], "K": found.get("K_fullimg")})
    ]


def people_by_name(pose: str) -> Callable[[str, dict], People]:
    """Return a reader of a dictionary by people; people without a ``pose`` are left out."""

    def people(where: str, found: dict) -> People:
        for name, person in found.items():
            if holds(person, pose) and person[pose] is not None:
                ids = person.get("frame_ids", person.get("frame_id"))
                numbers = np.arange(len(person[pose])) if ids is None else frame_numbers(ids)
                yield SeenPerson(str(name), numbers, person)

    return people


def hybrik_person(where: str, found: dict) -> People:
    """Read HybrIK's person; the pictures' names number the frames."""
    yield SeenPerson("0", frames_named(np.ravel(found["img_path"])), found)


def phalp_people(where: str, found: dict) -> People:
    """Read PHALP's dictionary by frames, with lists of people; keep the tracked people."""
    rows: list[Row] = []
    for k, name in enumerate(sorted(found)):
        frame = found[name]
        number, tracked = int(frame.get("time", k)), frame.get("tracked_ids", frame["tid"])
        tracked = {int(i) for i in tracked}
        for person, smpl, camera in zip(frame["tid"], frame["smpl"], frame["camera"], strict=False):
            if int(person) in tracked:
                some = {key: smpl[key] for key in ("global_orient", "body_pose", "betas")}
                rows.append(Row(str(int(person)), number, some | {"camera": camera}))
    return stacked(where, rows)


def romp_people(where: str, found: Any) -> People:  # noqa: ANN401
    """Read ROMP's and BEV's people by track id; without ids, track the nearest person."""
    frames = _romp_frames(found)
    named = all("track_ids" in x for _, x in frames if len(x["smpl_thetas"]))
    rows: list[Row] = []
    for number, x in frames:
        for k in range(len(x["smpl_thetas"])):
            person = str(np.ravel(x["track_ids"])[k]) if named else None
            some = {name: x[name][k] for name in ("smpl_thetas", "smpl_betas", "cam_trans")}
            rows.append(Row(person, number, some))
    people = stacked(where, rows) if named else followed(where, rows, "cam_trans")
    for person in people:
        x = person.arrays
        if x["smpl_betas"].shape[1] == 11:  # BEV, whose translation is the middle of the hips
            R = to_matrices(x["smpl_thetas"][:, :3])
            x["cam_trans"] = x["cam_trans"] - R @ _PELVIS_TO_HIPS - np.array(MEAN_PELVIS["SMPL"])
        x["smpl_betas"] = x["smpl_betas"][:, :10]
    return people


def _romp_frames(found: Any) -> list[tuple[int, dict]]:  # noqa: ANN401
    """Return number and result of each frame: of a video's file, or of a file a frame."""
    if isinstance(found, Path) and (found / "video_results.npz").is_file():
        found = read_named(found / "video_results.npz", "ROMP's results of a video")
    if isinstance(found, Path):
        read = lambda path: one_object(read_named(path, "ROMP's results of a frame")["results"])
        named = {path.stem: read(path) for path in files_in(found)}
    else:
        results = one_object(found["results"])
        if "smpl_thetas" in results:
            return [(0, results)]
        named = {Path(str(name)).stem: result for name, result in results.items()}
    numbers = frames_named([_BEV_SUFFIX.sub("", name) for name in named]).tolist()
    return sorted(zip(numbers, named.values(), strict=True), key=lambda frame: frame[0])


def is_romp(found: Any) -> bool:  # noqa: ANN401
    first = first_of(found)
    return holds(first, "results") and isinstance(one_object(first["results"]), dict)


def smplerx_files(found: Any) -> list[tuple[str, int, Path]]:  # noqa: ANN401
    """Return person, frame and file of each ``smplx/00001_0.npz``."""
    inner = isinstance(found, Path) and (found / "smplx").is_dir()
    files = files_in(found / "smplx" if inner else found, "*.npz")
    matches = ((path, _SMPLERX_FILE.fullmatch(path.name)) for path in files)
    return sorted((match[2], int(match[1]), path) for path, match in matches if match)


def smplerx_people(where: str, found: Path) -> People:
    """Read SMPLer-X's files: one per frame and person, the lens under that name in ``meta/``.

    It numbers the people of each frame anew, in the order of its detector.
    """
    rows: list[Row] = []
    for _, frame, path in smplerx_files(found):
        arrays = read_named(path, "SMPL-X's parameters of one frame")
        about = path.parent.parent / "meta" / path.with_suffix(".json").name
        with expecting(about, EXPECTED_CAMERA):
            lens = read_json(about, EXPECTED_CAMERA)
            K = pinhole_K(np.reshape(lens["focal"], 2), np.reshape(lens["princpt"], 2))
        arrays = {name: x for name, x in arrays.items() if name in _SMPLX_NAMES}
        rows.append(Row(None, frame, arrays | {"K": K}))
    return followed(where, rows, "transl")


def named_people(where: str, found: Any) -> Iterator[SeenPerson]:  # noqa: ANN401
    """Read people by the names of :mod:`.body_arrays`.

    A file holds arrays of one person; or of several, the first axis counting them; or a dictionary
    for each person, or for each frame. A folder holds a file for each frame.
    """
    parts = posed_parts(found)
    if isinstance(found, Path):
        expected = "a body's parameters by name"
        parts = {path: unnested(read_named(path, expected)) for path in files_in(found)}
    poses = lambda name: len(find_body(f"{where}: {name}", parts[name]).rotations)
    one_pose = lambda name: numbers_in(name) and poses(name) == 1
    if isinstance(found, Path) or (len(parts) > 1 and all(map(one_pose, parts))):
        first = next(iter(parts.values()))
        numbers = [k for k, x in first.items() if np.asarray(x).dtype.kind in "fiu"]
        rows = [{k: part[k] for k in numbers if k in part} for part in parts.values()]
        frames = frames_named(list(parts)).tolist()
        yield from stacked(where, (Row("0", k, row) for k, row in zip(frames, rows, strict=True)))
    elif len(parts) > 1:
        yield from (SeenPerson(str(name), None, part) for name, part in parts.items())
    else:
        yield from _by_first_axis(where, unnested(found))


def _by_first_axis(where: str, found: dict) -> Iterator[SeenPerson]:
    """Yield the people of arrays (people, T, ...), as 3DPW and SLAHMR write them, or the one."""
    arrays = NamedArrays(where, found)
    count, *shape = np.shape(found.get(arrays.find("transl"))) or (0,)
    if len(shape) != 2 or shape[1] != 3 or min(count, shape[0]) < 2:
        yield SeenPerson("0", None, found)
        return
    known = {arrays.find(name) for name in (*ALL_JOINTS_NAMES, *ARRAY_NAMES)} - {None}
    of_all = [x for x in known if np.ndim(found[x]) > 1 and len(found[x]) == count]
    for k in range(count):
        yield SeenPerson(str(k), None, found | {name: found[name][k] for name in of_all})


def no_lens(where: str, arrays: Arrays, info: VideoInfo) -> np.ndarray:
    return np.eye(3)


def wham_lens(where: str, arrays: Arrays, info: VideoInfo) -> np.ndarray:
    return centred(np.ravel(arrays.get("focal_length", np.hypot(*info.size)))[0], info.size)


def phalp_lens(where: str, arrays: Arrays, info: VideoInfo) -> np.ndarray:
    return centred(_HMR_FOCAL * max(info.size), info.size)


def hybrik_lens(where: str, arrays: Arrays, info: VideoInfo) -> np.ndarray:
    """Return HybrIK's lens, which follows from the person's box in each frame."""
    box = np.reshape(arrays["bbox"], (-1, 4))
    sizes = (np.broadcast_to(np.ravel(arrays[name]), len(box)) for name in ("width", "height"))
    widths = _HYBRIK_FOCAL * (box[:, 2] - box[:, 0])
    return np.stack([
        rescaled(where, centred(f, of), of, info.size)
        for f, *of in zip(widths, *sizes, strict=True)
    ])  # fmt: skip


def romp_lens(where: str, arrays: Arrays, info: VideoInfo) -> np.ndarray:
    """Return ROMP's lens: it pads pictures to a square, whose centre is rounded to whole pixels."""
    side = max(info.size)
    K = centred(_ROMP_FOCAL * side, info.size)
    K[:2, 2] = [side / 2 - (side - length) // 2 for length in info.size]
    return K


def lens_by_name(where: str, arrays: Arrays, info: VideoInfo) -> np.ndarray:
    """Return the camera in a file, or a centred one with the user's focal length.

    It is rescaled to the video, if the file records the size of its pictures.
    """
    size = [np.ravel(arrays[x])[0] for x in ("width", "height") if arrays.get(x) is not None]
    size = size if len(size) == 2 and info.is_known else info.size
    for name in ("K", "cam_K", "intrinsic", "intrinsics"):
        if arrays.get(name) is not None:
            K = np.asarray(arrays[name], np.float64)
            if K.shape[-2:] != (3, 3) or K.ndim > 3:
                raise InputError(f"{where}: '{name}' must be (3, 3) or (T, 3, 3), got {K.shape}")
            return rescaled(where, K.reshape(-1, 3, 3), size, info.size)
    names = ("focal", "focal_length", "focal_l")
    focal = next((x for name in names if (x := arrays.get(name)) is not None), None)
    if focal is None:
        focal, size = info.focal, info.size
    if focal is None:
        raise InputError(f"{where}: holds no camera (K, or focal); give --lens, such as 26mm")
    focal = np.ravel(np.asarray(focal, np.float64))
    if not focal.size or not (focal > 0).all():
        raise InputError(f"{where}: 'focal' must be one number above 0, or (T,); got {focal}")
    return rescaled(where, np.stack([centred(f, size) for f in focal]), size, info.size)
