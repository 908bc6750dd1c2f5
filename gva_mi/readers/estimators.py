"""Pose estimators: :data:`KINDS` says where each program's files keep which array, and its meaning.

Another estimator is another record. ``docs/sources.md`` lists the files. Root rotation and
translation are in the camera's axes. The focal length that an estimator assumed is kept, because
its translations hold with that one only.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.body.pose import SMPLX_FIELDS
from gva_mi.body.rotations import to_matrices
from gva_mi.core.errors import InputError, expecting
from gva_mi.core.files import read_json
from gva_mi.core.pickles import read_objects
from gva_mi.readers.body_arrays import (
    NOT_BODY_NAMES,
    NamedArrays,
    holds_pose,
    is_numbers,
    one_object,
    unnested,
)
from gva_mi.readers.people import Arrays, Row, SeenPerson, followed, stacked
from gva_mi.readers.track import (
    MEAN_PELVIS,
    TargetBody,
    Track,
    listed_names,
    make_track,
)
from gva_mi.subject.footage import frame_numbers, frames_named
from gva_mi.subject.lens import EXPECTED_CAMERA, centred, pinhole_K, rescaled

_PICKLED = (".pkl", ".pickle", ".npz", ".npy", ".pt")
_OF_BEV = re.compile(r"__\d+_[\d.]+$")  # what BEV adds to a picture's name
_OF_SMPLERX = re.compile(r"(\d+)_(\d+)\.npz")  # frame and person
_OF_SMPLX = (*SMPLX_FIELDS, "transl", "betas", "expression")
# From the pelvis to the middle of the hips at rest, metres: BEV's translations are of the latter.
_TO_HIPS = np.array([0.0, -0.09, -0.01])


@dataclass(frozen=True)
class VideoInfo:
    """Facts about the video that a reader needs besides the file."""

    size: tuple[int, int]  # (W, H) of the video, pixels
    focal: float | None = None  # pixels, where the file says none
    body: TargetBody | None = None  # that poses are converted to


People = Iterable[SeenPerson]


@dataclass(frozen=True)
class Estimator:
    """Rules that recognise one estimator's files, and the meaning of their arrays."""

    expects: str  # for messages
    recognises: Callable[[Any], bool]  # of what a file holds, or of a folder's path
    people: Callable[[str, Any], People]  # where, what a file holds
    # Our name: the file's name. Empty: any names of body_arrays.
    arrays: Mapping[str, str] = field(default_factory=dict)
    # Where, arrays of a person: K (3, 3) or (n, 3, 3). By default it is the file's own.
    lens: Callable[[str, Arrays, VideoInfo], np.ndarray] = lambda where, arrays, info: arrays["K"]  # noqa: E731
    of_pelvis: bool = False  # its translation is the pelvis's position
    mean_hand: bool = False  # fingers are relative to the mean hand
    needs_video: bool = False  # places follow from an assumed lens: it is no motion on its own
    up: str | None = "-y"  # the axis of its people that is up; None: any
    # The number that it gives the first frame; None: that of the picture, by its name.
    first: int | None = 0

    def tracks(self, where: str, found: Any, info: VideoInfo) -> list[Track]:  # noqa: ANN401
        """Return the people in the camera's axes, one track each, frames ascending."""
        tracks = []
        for person in self.people(where, found):
            at = f"{where}: person {person.name}"
            K = np.asarray(self.lens(at, person.arrays, info), np.float64)
            given, notes = self._named(person.arrays)
            track = make_track(at, person.name, person.frames, given, K, info.body, self.of_pelvis)
            mean = self.mean_hand and track.has_hands
            track = replace(track, from_mean_hand=mean, notes=(*track.notes, *notes))
            tracks.append(track.where(np.unique(track.frames, return_index=True)[1]))
        return tracks

    def _named(self, found: Arrays) -> tuple[Arrays, list[str]]:
        """Return the arrays under our names, and a note on numbers that are not used."""
        if not self.arrays:
            return found, []
        known = {*NOT_BODY_NAMES, *self.arrays.values()}
        rest = sorted(k for k, x in found.items() if k not in known and is_numbers(x))
        notes = [f"not used of the source: {listed_names(rest)}"] if rest else []
        return {ours: found[x] for ours, x in self.arrays.items() if x in found}, notes


def read_estimator(kind: str, source: Path, info: VideoInfo) -> tuple[str, list[Track]]:
    """Read the people in an estimator's file or folder, and return them with its kind.

    ``kind`` is one of :data:`KINDS`, or "auto". Nothing in the file is executed.
    """
    found = read_source(source)
    kind = kind_of(found) or "" if kind == "auto" else kind
    if not kind:
        known = "; ".join(f"{name}: {record.expects}" for name, record in KINDS.items())
        raise InputError(f"{source}: of no known kind, holds {_contents(found)}; expected {known}")
    record = KINDS[kind]
    if not record.recognises(found):
        raise InputError(
            f"{source}: not of the kind {kind}, holds {_contents(found)}; expected {record.expects}"
        )
    with expecting(f"{source} (of the kind {kind})", record.expects):
        return kind, record.tracks(str(source), found, info)


def kind_of(found: Any) -> str | None:  # noqa: ANN401
    """Return which of :data:`KINDS` wrote a file (its content) or folder (its path), or None."""
    return next((name for name, record in KINDS.items() if record.recognises(found)), None)


def read_source(source: Path, expected: str = "what a pose estimator wrote") -> Any:  # noqa: ANN401
    """Read a file's content; for a folder, return its path."""
    return source if source.is_dir() else one_object(read_objects(source, expected))


def read_named(path: Path, expected: str) -> dict:
    """Read a file's content as a dictionary."""
    found = read_source(path, expected)
    if not isinstance(found, dict):
        raise InputError(f"{path}: holds {_contents(found)}, and no names; expected {expected}")
    return found


def files_in(found: Any, pattern: str = "*") -> list[Path]:  # noqa: ANN401
    """Return a folder's files of a pattern, sorted by name."""
    paths = found.glob(pattern) if isinstance(found, Path) else ()
    return sorted(path for path in paths if path.suffix in _PICKLED)


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
    """Whether a file's content has all these names; "a|b" is either of two."""
    return isinstance(found, Mapping) and all(
        any(name in found for name in either.split("|")) for either in names
    )


def _contents(found: Any) -> str:  # noqa: ANN401
    """Describe in a few words what a file or a folder holds."""
    if isinstance(found, Path):
        return f"files such as {listed_names(sorted(path.name for path in found.iterdir())[:4])}"
    if isinstance(found, Mapping):
        return listed_names([f"{name!s:.40}" for name in found]) or "nothing"
    shape = f" {found.shape}" if isinstance(found, np.ndarray) else ""
    return f"one {type(found).__name__}{shape} without names"


# The layouts of files: what they hold becomes people.


def _person_in(name: str) -> Callable[[str, dict], People]:
    """Return a reader of one person, whose arrays lie under ``name``; with GVHMR's lens."""
    return lambda where, found: [
        SeenPerson("0", None, {**found[name], "K": found.get("K_fullimg")})
    ]


def _by_person(pose: str) -> Callable[[str, dict], People]:
    """Return a reader of a dictionary by people, of those who have a ``pose``."""

    def people(where: str, found: dict) -> People:
        for name, person in found.items():
            if holds(person, pose) and person[pose] is not None:
                ids = person.get("frame_ids", person.get("frame_id"))
                numbers = np.arange(len(person[pose])) if ids is None else frame_numbers(ids)
                yield SeenPerson(str(name), numbers, person)

    return people


def _has_one(found: Any, *names: str) -> bool:  # noqa: ANN401
    """Whether one of a file's people, or frames, has all these names, the first not as None."""
    whole = isinstance(found, Mapping)
    return whole and any(holds(x, *names) and x[names[0]] is not None for x in found.values())


def _by_picture(where: str, found: dict) -> People:
    """Read HybrIK's person, whose frames are known by the pictures' names."""
    yield SeenPerson("0", frames_named(np.ravel(found["img_path"])), found)


def _phalp(where: str, found: dict) -> People:
    """Read PHALP's dictionary by frames, with lists of people; those that it tracks count."""
    rows: list[Row] = []
    for k, name in enumerate(sorted(found)):
        frame = found[name]
        number, tracked = int(frame.get("time", k)), frame.get("tracked_ids", frame["tid"])
        tracked = {int(i) for i in tracked}
        for person, smpl, camera in zip(frame["tid"], frame["smpl"], frame["camera"], strict=False):
            if int(person) in tracked:
                some = {key: smpl[key] for key in ("global_orient", "body_pose", "betas")}
                rows.append((str(int(person)), number, some | {"camera": camera}))
    return stacked(where, rows)


def _romp(where: str, found: Any) -> People:  # noqa: ANN401
    """Read ROMP's and BEV's people by track id; without ids, track the nearest person."""
    frames = _romp_frames(found)
    named = all("track_ids" in x for _, x in frames if len(x["smpl_thetas"]))
    rows: list[Row] = []
    for number, x in frames:
        for k in range(len(x["smpl_thetas"])):
            person = str(np.ravel(x["track_ids"])[k]) if named else None
            some = {name: x[name][k] for name in ("smpl_thetas", "smpl_betas", "cam_trans")}
            rows.append((person, number, some))
    people = stacked(where, rows) if named else followed(where, rows, "cam_trans")
    for person in people:
        x = person.arrays
        if x["smpl_betas"].shape[1] == 11:  # BEV, whose place is that of the hips
            R = to_matrices(x["smpl_thetas"][:, :3])
            x["cam_trans"] = x["cam_trans"] - R @ _TO_HIPS - np.array(MEAN_PELVIS["SMPL"])
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
    numbers = frames_named([_OF_BEV.sub("", name) for name in named]).tolist()
    return sorted(zip(numbers, named.values(), strict=True), key=lambda frame: frame[0])


def _is_romp(found: Any) -> bool:  # noqa: ANN401
    first = first_of(found)
    return holds(first, "results") and isinstance(one_object(first["results"]), dict)


def _smplerx_files(found: Any) -> list[tuple[str, int, Path]]:  # noqa: ANN401
    """Return person, frame and file of each ``smplx/00001_0.npz``."""
    inner = isinstance(found, Path) and (found / "smplx").is_dir()
    files = files_in(found / "smplx" if inner else found, "*.npz")
    matches = ((path, _OF_SMPLERX.fullmatch(path.name)) for path in files)
    return sorted((match[2], int(match[1]), path) for path, match in matches if match)


def _smplerx(where: str, found: Path) -> People:
    """Read SMPLer-X's files: one per frame and person, the lens under that name in ``meta/``.

    It numbers the people of each frame anew, in the order of its detector.
    """
    rows: list[Row] = []
    for _, frame, path in _smplerx_files(found):
        arrays = read_named(path, "SMPL-X's parameters of one frame")
        about = path.parent.parent / "meta" / path.with_suffix(".json").name
        with expecting(about, EXPECTED_CAMERA):
            lens = read_json(about, EXPECTED_CAMERA)
            K = pinhole_K(np.reshape(lens["focal"], 2), np.reshape(lens["princpt"], 2))
        arrays = {name: x for name, x in arrays.items() if name in _OF_SMPLX}
        rows.append((None, frame, arrays | {"K": K}))
    return followed(where, rows, "transl")


def _parameters(where: str, found: Any) -> Iterator[SeenPerson]:  # noqa: ANN401
    """Read one person from a file, or from one file per frame, by :mod:`.body_arrays`."""
    if isinstance(found, dict):
        found = unnested(found)
        if NamedArrays(where, found).find("transl") is None:
            raise InputError(f"{where}: holds no translation; expected transl (T, 3) in the camera")
        yield SeenPerson("0", None, found)
        return
    files = files_in(found)
    each = [unnested(read_named(path, "a body's parameters by name")) for path in files]
    numbers = [k for k, x in each[0].items() if np.asarray(x).dtype.kind in "fiu"]
    rows = [{k: frame[k] for k in numbers if k in frame} for frame in each]
    frames = frames_named(files).tolist()
    yield from stacked(found, (("0", k, row) for k, row in zip(frames, rows, strict=True)))


# The lenses that estimators assume.


def _no_lens(where: str, arrays: Arrays, info: VideoInfo) -> np.ndarray:
    return np.eye(3)


def _lens_of_wham(where: str, arrays: Arrays, info: VideoInfo) -> np.ndarray:
    return centred(np.ravel(arrays.get("focal_length", np.hypot(*info.size)))[0], info.size)


def _lens_of_phalp(where: str, arrays: Arrays, info: VideoInfo) -> np.ndarray:
    return centred(5000 / 256 * max(info.size), info.size)


def _lens_of_hybrik(where: str, arrays: Arrays, info: VideoInfo) -> np.ndarray:
    """Return HybrIK's lens for each person's box, rescaled from its picture size to the video's."""
    box = np.reshape(arrays["bbox"], (-1, 4))
    sizes = (np.broadcast_to(np.ravel(arrays[name]), len(box)) for name in ("width", "height"))
    widths = 1000 / 256 * (box[:, 2] - box[:, 0])
    return np.stack([
        rescaled(where, centred(f, of), of, info.size)
        for f, *of in zip(widths, *sizes, strict=True)
    ])  # fmt: skip


def _lens_of_romp(where: str, arrays: Arrays, info: VideoInfo) -> np.ndarray:
    """Return ROMP's lens: it pads pictures to a square, whose centre is rounded to whole pixels."""
    side = max(info.size)
    K = centred(443.4 / 512 * side, info.size)
    K[:2, 2] = [side / 2 - (side - length) // 2 for length in info.size]
    return K


def lens_by_name(where: str, arrays: Arrays, info: VideoInfo) -> np.ndarray:
    """Return the camera in a file, or one of the focal length that a user gives."""
    for name in ("K", "cam_K", "intrinsic", "intrinsics"):
        if arrays.get(name) is not None:
            K = np.asarray(arrays[name], np.float64)
            if K.shape[-2:] != (3, 3) or K.ndim > 3:
                raise InputError(f"{where}: '{name}' must be (3, 3) or (T, 3, 3), got {K.shape}")
            return K.reshape(-1, 3, 3)
    names = ("focal", "focal_length", "focal_l")
    focal = next((x for name in names if (x := arrays.get(name)) is not None), info.focal)
    if focal is None:
        raise InputError(f"{where}: says no camera (K, or focal); give --lens, such as 26mm")
    focal = np.ravel(np.asarray(focal, np.float64))
    if not focal.size or not (focal > 0).all():
        raise InputError(f"{where}: 'focal' must be one number above 0, or (T,); got {focal}")
    return np.stack([centred(f, info.size) for f in focal])


KINDS: dict[str, Estimator] = {
    "wham": Estimator(
        "people with pose, trans and frame_ids",
        lambda x: _has_one(x, "pose", "trans", "frame_ids|frame_id"),
        _by_person("pose"),
        {"poses": "pose", "transl": "trans", "betas": "betas"},
        _lens_of_wham,
    ),
    "gvhmr": Estimator(
        "smpl_params_incam and K_fullimg",
        lambda x: holds(x, "smpl_params_incam", "K_fullimg"),
        _person_in("smpl_params_incam"),
    ),
    "4dhumans": Estimator(
        "frames with tid, smpl and camera",
        lambda x: _has_one(x, "tid", "smpl", "camera"),
        _phalp,
        {"global_orient": "global_orient", "body_pose": "body_pose", "betas": "betas",
         "transl": "camera"},
        _lens_of_phalp,
        needs_video=True,
    ),
    "hybrik": Estimator(
        "pred_thetas, pred_cam_root and bbox",
        lambda x: holds(x, "pred_thetas", "pred_cam_root", "bbox"),
        _by_picture,
        {"poses": "pred_thetas", "transl": "pred_cam_root", "betas": "pred_betas"},
        _lens_of_hybrik,
        of_pelvis=True,
        needs_video=True,
        first=1,
    ),
    "romp": Estimator(
        "results with smpl_thetas and cam_trans",
        _is_romp,
        _romp,
        {"poses": "smpl_thetas", "transl": "cam_trans", "betas": "smpl_betas"},
        _lens_of_romp,
        first=None,
    ),
    "smplerx": Estimator(
        "a folder with smplx/00001_0.npz and meta/00001_0.json",
        lambda x: bool(_smplerx_files(x)),
        _smplerx,
        mean_hand=True,
        first=1,
    ),
    "parameters": Estimator(
        "global_orient, body_pose and transl by name, in a file or one a frame",
        lambda x: holds_pose(unnested(first_of(x))),
        _parameters,
        lens=lens_by_name,
        up=None,
        first=None,
    ),
}  # fmt: skip
WORLDS = {  # of people in the estimator's own world
    "wham": Estimator(
        "people with pose_world",
        lambda x: _has_one(x, "pose_world"),
        _by_person("pose_world"),
        {"poses": "pose_world", "transl": "trans_world", "betas": "betas"},
        _no_lens,
        up="y",
    ),
    "gvhmr": Estimator(
        "smpl_params_global",
        lambda x: holds(x, "smpl_params_global"),
        _person_in("smpl_params_global"),
        lens=_no_lens,
        up="y",
    ),
}
