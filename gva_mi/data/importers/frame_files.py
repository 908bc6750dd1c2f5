"""Estimators that write a folder, a file a frame or a person: readers of :mod:`estimators`."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import roma
import torch

from gva_mi.body.pose import SMPLX_FIELDS
from gva_mi.data.importers.readings import (
    View,
    centred,
    follow,
    make_track,
    of_pelvis,
)  # fmt: skip
from gva_mi.data.importers.tracks import Track
from gva_mi.data.importers.whole_videos import FAR_FOCAL, frame_numbers, last_number
from gva_mi.errors import InputError, expecting
from gva_mi.files import read_json
from gva_mi.pickles.reader import read_objects

ROMP_FOCAL = 443.4 / 512  # focal length over the side of the square that pictures are padded to
MULTI_HMR_ANGLE = 60.0  # degrees that the side of such a square is seen under
# From the pelvis to the middle of the hips at rest, metres: BEV's bodies stand on the latter.
_TO_HIPS = np.array([0.0, -0.09, -0.01])
_NUMBERED = re.compile(r"(\d+)_(\d+)\.npz")  # frame, person
_ROMP = "results"  # the one key of ROMP's .npz
_PICKLED = (".pkl", ".pickle", ".npz", ".npy", ".pt")


def plain(found: Any) -> Any:  # noqa: ANN401
    """What an array of one object holds: numpy's way to keep a dictionary.

    A ``.npz`` of nothing but such an array is read as a ``.npy`` of it, whatever its key is: but
    for ROMP's, whose readers go by it.
    """
    if isinstance(found, dict) and len(found) == 1:
        (key, value), *_ = found.items()
        inner = _one_object(value)
        if key == "arr_0" and isinstance(value, np.ndarray):  # numpy's own name of what has none
            return inner
        return inner if isinstance(inner, dict) and inner is not value and key != _ROMP else found
    return _one_object(found)


def _one_object(found: Any) -> Any:  # noqa: ANN401
    one = isinstance(found, np.ndarray) and found.dtype.hasobject and found.size == 1
    return found.item() if one else found


def _files(found: Any, pattern: str = "*") -> list[Path]:  # noqa: ANN401
    """Files of a folder, in the order of their names."""
    if not isinstance(found, Path):
        return []
    return sorted(path for path in found.glob(pattern) if path.suffix in _PICKLED)


def first_of(found: Any) -> Any:  # noqa: ANN401
    """What the first file of a folder holds; the folder's kind is told by it."""
    files = _files(found)
    try:
        return plain(read_objects(files[0], "what a pose estimator wrote")) if files else None
    except InputError:
        return None


def is_smplerx(found: Any) -> bool:  # noqa: ANN401
    return any(_NUMBERED.fullmatch(path.name) for path in _smplerx_files(found))


def _smplerx_files(found: Any) -> list[Path]:  # noqa: ANN401
    inner = isinstance(found, Path) and (found / "smplx").is_dir()
    return _files(found / "smplx" if inner else found, "*.npz")


def read_smplerx(where: str, found: Path, view: View) -> list[Track]:
    people: dict[str, list[tuple[int, Path]]] = {}
    for path in _smplerx_files(found):
        if match := _NUMBERED.fullmatch(path.name):
            people.setdefault(match[2], []).append((int(match[1]), path))
    tracks = []
    for person, seen in people.items():
        files = [path for _, path in seen]
        frames, given = np.array([frame for frame, _ in seen]), _stacked(files)
        K = np.stack([_meta(path) for path in files])
        track = make_track(f"{where}: person {person}", person, frames, given, K)
        # Its body is made with the package's default, to which the mean hand is added.
        tracks.append(replace(track, from_mean_hand=track.has_hands))
    return tracks


def _stacked(files: list[Path]) -> dict[str, np.ndarray]:
    """Parameters of one frame a file, each of any shape, as rows of all frames."""
    rows: dict[str, list[np.ndarray]] = {}
    for path in files:
        found = plain(read_objects(path, "SMPL-X's parameters of one frame"))
        if not isinstance(found, dict):
            raise InputError(f"{path}: holds no arrays by name; expected SMPL-X's parameters")
        for name in (*SMPLX_FIELDS, "transl", "betas"):
            if name in found:
                rows.setdefault(name, []).append(np.ravel(found[name]))
    return _even(files[0].parent, rows, len(files))


def _even(folder: Path, rows: Mapping[str, list[np.ndarray]], count: int) -> dict[str, np.ndarray]:
    """Rows of all files as arrays, once all files have them in one shape."""
    uneven = [name for name, x in rows.items() if len({r.shape for r in x}) > 1]
    uneven += [name for name, x in rows.items() if len(x) < count]
    if uneven:
        raise InputError(f"{folder}: '{uneven[0]}' is not of one shape in all files")
    return {name: np.stack(x) for name, x in rows.items()}


def _meta(path: Path) -> np.ndarray:
    """K (3, 3) of a frame of SMPLer-X, from the file beside."""
    meta = path.parent.parent / "meta" / path.with_suffix(".json").name
    expected = f'{{"focal": [fx, fy], "princpt": [cx, cy]}} beside {path.name}'
    about = read_json(meta, expected)
    with expecting(meta, expected):
        (fx, fy), (cx, cy) = about["focal"], about["princpt"]
        return np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64)


def is_tram(found: Any) -> bool:  # noqa: ANN401
    return bool(_tram_files(found))


def _tram_files(found: Any) -> list[Path]:  # noqa: ANN401
    return _files(found, "hps/hps_track_*.npy") or _files(found, "hps_track_*.npy")


def tram_camera(found: Path) -> dict:
    """What TRAM says of its camera: the lens, and by ``pred_cam_R``, ``pred_cam_T`` its path.

    Raises:
        InputError: no such file above ``hps/``, or it holds nothing by name.
    """
    files = _tram_files(found)
    path = (found if files[0].parent != found else found.parent) / "camera.npy"
    expected = "img_focal and img_center, as TRAM writes"
    about = plain(read_objects(path, expected))
    if not isinstance(about, dict):
        raise InputError(f"{path}: holds nothing by name; expected {expected}")
    return about


def read_tram(where: str, found: Path, view: View) -> list[Track]:
    """A file a person, and the lens in ``camera.npy``, which lies above ``hps/``."""
    files, tracks, about = _tram_files(found), [], tram_camera(found)
    focal = float(np.ravel(about["img_focal"])[0])
    centre = np.ravel(about["img_center"]).astype(np.float64)
    lens = np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1]])
    for path in files:
        person = plain(read_objects(path, "pred_rotmat, pred_trans and frame, as TRAM writes"))
        frames = frame_numbers(person["frame"])
        matrices = np.reshape(person["pred_rotmat"], (len(frames), -1, 3, 3))
        given = {
            "global_orient": matrices[:, :1], "body_pose": matrices[:, 1:],
            "transl": np.reshape(person["pred_trans"], (-1, 3)), "betas": person["pred_shape"],
        }  # fmt: skip
        K = np.tile(lens, (len(frames), 1, 1))
        tracks.append(make_track(str(path), str(last_number(path)), frames, given, K))
    return tracks


def is_romp(found: Any) -> bool:  # noqa: ANN401
    first = first_of(found) if isinstance(found, Path) else found
    return isinstance(first, dict) and isinstance(plain(first.get(_ROMP)), dict)


def read_romp(where: str, found: Any, view: View) -> list[Track]:  # noqa: ANN401
    """ROMP's and BEV's people, by their track ids; without these, who is nearest goes on."""
    seen = [(number, r) for number, r in _romp_frames(found) if len(r["smpl_thetas"])]
    if all("track_ids" in r for _, r in seen):
        names = [[str(i) for i in np.ravel(r["track_ids"])] for _, r in seen]
    else:
        names = follow([r["cam_trans"] for _, r in seen])
    people: dict[str, list[tuple[int, dict, int]]] = {}
    for (number, r), row in zip(seen, names, strict=True):
        for k, name in enumerate(row):
            people.setdefault(name, []).append((number, r, k))
    side, (width, height) = max(view.size), view.size
    lens = centred(ROMP_FOCAL * side, view.size, 1)[0]
    lens[:2, 2] = side / 2 - (side - width) // 2, side / 2 - (side - height) // 2
    tracks = []
    for name, rows in people.items():
        of = lambda key, rows=rows: np.stack([np.ravel(r[key][k]) for _, r, k in rows])
        thetas, betas, transl = of("smpl_thetas"), of("smpl_betas"), of("cam_trans")
        if betas.shape[1] == 11:  # BEV: the hips are there, and not the origin
            R = roma.rotvec_to_rotmat(torch.from_numpy(thetas[:, :3].astype(np.float64))).numpy()
            transl = of_pelvis(transl - R @ _TO_HIPS, "SMPL")
        given = {"smpl_thetas": thetas, "betas": betas[:, :10], "transl": transl}
        K, frames = np.tile(lens, (len(rows), 1, 1)), np.array([n for n, _, _ in rows])
        tracks.append(make_track(f"{where}: person {name}", name, frames, given, K))
    return tracks


def _romp_frames(found: Any) -> list[tuple[int, dict]]:  # noqa: ANN401
    """Number and result of each frame, by the first number of a picture's name."""
    first = lambda name: int(re.findall(r"\d+", Path(name).stem)[0])
    if isinstance(found, dict):
        results = plain(found[_ROMP])
        if "smpl_thetas" in results:
            return [(0, results)]
        return sorted(((first(name), r) for name, r in results.items()), key=lambda x: x[0])
    whole = found / "video_results.npz"
    if whole.is_file():
        return _romp_frames(read_objects(whole, "ROMP's results of a video"))
    files = _files(found, "*.npz")
    read = lambda path: plain(read_objects(path, "ROMP's results of a frame")[_ROMP])
    return sorted(((first(path.name), read(path)) for path in files), key=lambda x: x[0])


def is_multihmr(found: Any) -> bool:  # noqa: ANN401
    people = _humans(first_of(found))
    return bool(people) and {"rotvec", "transl_pelvis"} <= set(people[0])


def _humans(found: Any) -> list[dict]:  # noqa: ANN401
    """The people of a frame: a list of dictionaries, or one of them."""
    if isinstance(found, np.ndarray) and found.dtype.hasobject:
        found = found.ravel().tolist()
    found = [found] if isinstance(found, dict) else found
    whole = isinstance(found, list) and all(isinstance(p, dict) for p in found)
    return found if whole else []


def read_multihmr(where: str, found: Path, view: View) -> list[Track]:
    """Joints are the root, 21 of the body, both hands relative to flat ones, and the jaw."""
    frames = [
        (last_number(path), _humans(plain(read_objects(path, "the people of a frame"))))
        for path in _files(found)
    ]
    frames = sorted((frame for frame in frames if frame[1]), key=lambda frame: frame[0])
    names = follow([[np.ravel(p["transl_pelvis"]) for p in people] for _, people in frames])
    seen: dict[str, list[tuple[int, dict]]] = {}
    for (number, people), row in zip(frames, names, strict=True):
        for person, name in zip(people, row, strict=True):
            seen.setdefault(name, []).append((number, person))
    focal = max(view.size) / 2 / np.tan(np.radians(MULTI_HMR_ANGLE / 2))
    tracks = []
    for name, rows in seen.items():
        of = lambda key, rows=rows: np.stack([np.ravel(person[key]) for _, person in rows])
        joints = of("rotvec").reshape(len(rows), 53, 3)
        given = {
            "global_orient": joints[:, :1], "body_pose": joints[:, 1:22],
            "left_hand_pose": joints[:, 22:37], "right_hand_pose": joints[:, 37:52],
            "jaw_pose": joints[:, 52:], "betas": of("shape"),
            "transl": of_pelvis(of("transl_pelvis"), "SMPL-X"),
        }  # fmt: skip
        numbers = np.array([number for number, _ in rows])
        K = centred(view.focal or focal, view.size, len(rows))
        tracks.append(make_track(f"{where}: person {name}", name, numbers, given, K))
    return tracks


def _smplifyx_files(found: Any) -> list[Path]:  # noqa: ANN401
    return _files(found, "results/*/*.pkl") or _files(found, "*/*.pkl")


def is_smplifyx(found: Any) -> bool:  # noqa: ANN401
    files = _smplifyx_files(found)
    return bool(files) and "camera_translation" in _dictionary(files[0])


def _dictionary(path: Path) -> dict:
    found = plain(read_objects(path, "a body's parameters by name"))
    return found if isinstance(found, dict) else {}


def read_smplifyx(where: str, found: Path, view: View) -> list[Track]:
    """A folder a picture and a file a person; the lens is SMPLify-X's own, or of ``--focal``."""
    people: dict[str, list[tuple[int, Path]]] = {}
    for path in _smplifyx_files(found):
        people.setdefault(path.stem, []).append((last_number(path.parent.name), path))
    tracks = []
    for name, seen in people.items():
        rows: dict[str, list[np.ndarray]] = {}
        for _, path in seen:
            for key, value in _dictionary(path).items():
                if key in (*SMPLX_FIELDS, "betas", "camera_translation"):
                    rows.setdefault(key, []).append(np.ravel(value))
        given = _even(found, rows, len(seen))
        given["transl"] = given.pop("camera_translation")
        frames = np.array([number for number, _ in seen])
        K = centred(view.focal or FAR_FOCAL, view.size, len(seen))
        at = f"{where}: person {name}"
        track = make_track(at, name, frames, given, K, view.components)
        tracks.append(replace(track, from_mean_hand=track.has_hands))
    return tracks


def is_parameters(found: Any) -> bool:  # noqa: ANN401
    first = found if isinstance(found, dict) else first_of(found)
    return isinstance(first, dict) and bool(
        {"body_pose", "poses", "thetas", "fullpose"} & set(first)
    )


def read_parameters(where: str, found: Any, view: View) -> list[Track]:  # noqa: ANN401
    """One person under the names of :mod:`fields`, in the camera's axes: a file, or one a frame."""
    if isinstance(found, dict):
        given, count = found, None
    else:
        files = sorted(_files(found), key=last_number)
        each = [_dictionary(path) for path in files]
        rows = {
            key: [np.asarray(frame[key]) for frame in each if key in frame]
            for key in each[0]
            if np.asarray(each[0][key]).dtype.kind in "fiu"
        }
        given, count = _even(found, rows, len(each)), len(each)
        given = {key: x.reshape(count, *_without_one(x.shape[1:])) for key, x in given.items()}
    if not any(given.get(name) is not None for name in ("trans", "transl", "translation")):
        raise InputError(f"{where}: holds no translation; expected transl (T, 3) in the camera")
    if count is None:
        count = np.size(next(given[n] for n in ("trans", "transl", "translation") if n in given))
        count //= 3
        frames = np.arange(count)
    else:
        frames = np.array([last_number(path) for path in files])
    K = _lens(where, given, view, count)
    return [make_track(where, "0", frames, given, K, view.components)]


def _without_one(shape: Sequence[int]) -> tuple[int, ...]:
    """A frame's shape without the axis of the one frame that it holds."""
    return tuple(shape[1:]) if len(shape) > 1 and shape[0] == 1 else tuple(shape)


def _lens(where: str, given: Mapping[str, Any], view: View, count: int) -> np.ndarray:
    """K (count, 3, 3) of what a file says, or of ``--focal``."""
    for name in ("K", "cam_K", "intrinsic", "intrinsics"):
        if given.get(name) is not None:
            K = np.asarray(given[name], np.float64)
            if K.shape[-2:] != (3, 3) or K.size not in (9, 9 * count):
                raise InputError(f"{where}: '{name}' must be (3, 3) or (T, 3, 3), got {K.shape}")
            return np.broadcast_to(K.reshape(-1, 3, 3), (count, 3, 3))
    focal = given.get("focal", given.get("focal_length", view.focal))
    if focal is None:
        raise InputError(f"{where}: says no camera (K, or focal); give --focal, in pixels")
    focal = np.ravel(np.asarray(focal, np.float64))
    if focal.size not in (1, count) or not (focal > 0).all():
        raise InputError(f"{where}: 'focal' must be one number above 0, or (T,); got {focal}")
    K = centred(1.0, view.size, count)
    K[:, 0, 0] = K[:, 1, 1] = focal
    return K
