"""Data sets that many cameras filmed; one of them, ``--camera``, becomes the video.

=============  ====================================================  ===========================
Kind           Folder, by the public repository's own code           Cameras
=============  ====================================================  ===========================
``zju``        ``annots.npy``, ``new_params/`` or ``params/``,       ``K``, ``D``, ``R``, and
               ``mask_cihp/`` or ``mask/`` (zju3dv/neuralbody)       ``T`` in millimetres
``easymocap``  ``intri.yml``, ``extri.yml``, ``images/1/``,          ``K_1``, ``dist_1``,
               ``mask/1/``, and SMPL's ``smpl/000000.json``          ``Rot_1``, ``T_1``
               (zju3dv/EasyMocap)
``avatarrex``  ``calibration_full.json``, ``smpl_params.npz``,       ``K``, ``R``, ``T``
               ``22010708/`` with ``mask/pha/``
               (lizhe00/AnimatableGaussians)
=============  ====================================================  ===========================

EasyMocap's body turns about the origin, x = R(Rh) b + Th, and not about its pelvis p, so that its
translation here is R(Rh) p + Th − p. OpenCV, by which all are calibrated, has the centre of the
first pixel at 0 and not at 0.5.

A subject's folder has no place for other views of a real video: its ``truth/`` is of people whose
poses are known.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import roma
import torch

from gva_mi.data.importers.frame_files import plain
from gva_mi.data.importers.readings import PELVIS, make_track, seen_from
from gva_mi.data.importers.recordings import Recording
from gva_mi.data.importers.tracks import Track
from gva_mi.data.importers.whole_videos import last_number
from gva_mi.errors import InputError
from gva_mi.files import read_arrays, read_json
from gva_mi.pickles.reader import read_objects

_SMPL = ("output-smpl-3d/smpl", "output-smpl-3d/smplfull", "output/smpl", "smpl")
_MATRIX = re.compile(
    r"^(\w[\w.\-]*): *!!opencv-matrix\s+rows: *(\d+)\s+cols: *(\d+)\s+dt: *\w+\s+"
    r"data: *\[([^\]]*)\]",
    re.M,
)
_JPG = (".jpg", ".jpeg", ".png")


def is_zju(folder: Path) -> bool:
    return (folder / "annots.npy").is_file()


def read_zju(where: str, folder: Path, camera: str | None) -> Recording:
    found = plain(read_objects(folder / "annots.npy", "cams and ims, as ZJU-MoCap has them"))
    cameras = {str(k): k for k in range(len(found["cams"]["K"]))}
    name, k = _chosen(folder, cameras, camera)
    lens = {key: np.asarray(found["cams"][key][k], np.float64) for key in "KDRT"}
    names = [_inside(folder, frame["ims"][k]) for frame in found["ims"]]
    masks = next((m for m in ("mask_cihp", "mask") if (folder / m).is_dir()), "mask_cihp")
    params = next((p for p in ("new_params", "params") if (folder / p).is_dir()), "new_params")
    people = []
    for frame in names:
        path = folder / params / f"{_zju_number(frame)}.npy"
        people.append(plain(read_objects(path, "poses, shapes, Rh and Th of a frame")))
    track = _turned_about_origin(where, "0", np.arange(len(names)), people, _pixels(lens["K"]))
    track = seen_from(track, lens["R"].reshape(3, 3), lens["T"].ravel() / 1000)
    pictures = tuple(folder / frame for frame in names)
    cut_outs = tuple((folder / masks / frame).with_suffix(".png") for frame in names)
    return Recording(
        [track], pictures, cut_outs, lens["D"].ravel(), labels=True, note=_note(name, cameras)
    )


def _zju_number(name: str) -> int:
    """The number of a frame: of ``000010.jpg``, or of ``CoreView_313_Camera_(1)_0010_...jpg``."""
    stem = PurePosixPath(name).stem
    parts = stem.split("_")
    return int(parts[4]) if len(parts) > 4 else int(stem)


def _inside(folder: Path, name: object) -> str:
    """A path in a file, if it stays in the folder."""
    path = PurePosixPath(str(name))
    if path.is_absolute() or ".." in path.parts:
        raise InputError(f"{folder}: names the picture '{path}', which is outside of the folder")
    return str(path)


def is_easymocap(folder: Path) -> bool:
    return (folder / "intri.yml").is_file() and (folder / "extri.yml").is_file()


def read_easymocap(where: str, folder: Path, camera: str | None) -> Recording:
    inner, outer = (_yaml(folder / name) for name in ("intri.yml", "extri.yml"))
    cameras = {key[2:]: key[2:] for key in inner if key.startswith("K_")}
    name, _ = _chosen(folder, cameras, camera)
    params = next((folder / p for p in _SMPL if (folder / p).is_dir()), None)
    if params is None:
        raise InputError(f"{folder}: has none of {', '.join(_SMPL)}, with a .json a frame")
    people: dict[str, list[tuple[int, Mapping[str, Any]]]] = {}
    for path in sorted(params.glob("*.json"), key=last_number):
        frame = _json(path)
        for person in frame["annots"] if isinstance(frame, dict) else frame:
            people.setdefault(str(person.get("id", 0)), []).append((last_number(path), person))
    images = _pictures(folder / "images" / _inside(folder, name))
    places = {last_number(path): k for k, path in enumerate(images)}
    turn = torch.from_numpy(np.ravel(outer[f"R_{name}"])) if f"Rot_{name}" not in outer else None
    R = outer[f"Rot_{name}"] if turn is None else roma.rotvec_to_rotmat(turn).numpy()
    tracks = []
    for person, seen in people.items():
        kept = [(places[number], params) for number, params in seen if number in places]
        if kept:
            at, numbers = f"{params}: person {person}", np.array([number for number, _ in kept])
            each = [params for _, params in kept]
            track = _turned_about_origin(at, person, numbers, each, _pixels(inner[f"K_{name}"]))
            tracks.append(seen_from(track, R, np.ravel(outer[f"T_{name}"])))
    masks = folder / "mask" / name
    distortion = inner.get(f"dist_{name}", inner.get(f"D_{name}"))
    return Recording(
        tracks, images, _pictures(masks) if masks.is_dir() else None, distortion,
        note=_note(name, cameras),
    )  # fmt: skip


def _turned_about_origin(
    where: str, person: str, frames: np.ndarray, each: Sequence[Mapping[str, Any]], K: np.ndarray
) -> Track:
    """EasyMocap's parameters, of SMPL, as a track in its world."""
    rows = lambda name: np.stack([np.ravel(np.asarray(p[name], np.float64)) for p in each])
    poses, turns, places = rows("poses"), rows("Rh"), rows("Th")
    if poses.shape[1] == 69:
        poses = np.concatenate([np.zeros((len(poses), 3)), poses], axis=1)
    if poses.shape[1] != 72:
        raise InputError(
            f"{where}: 'poses' has {poses.shape[1]} numbers a frame; expected SMPL's 72, or 69 "
            "without the root"
        )
    turns = torch.from_numpy(turns)
    roots = torch.from_numpy(poses[:, :3].copy())
    poses[:, :3] = roma.rotvec_composition([turns, roots]).numpy()
    pelvis = np.array(PELVIS["SMPL"])
    transl = roma.rotvec_to_rotmat(turns).numpy() @ pelvis + places - pelvis
    given = {"poses": poses, "transl": transl, "betas": rows("shapes")}
    return make_track(where, person, frames, given, np.tile(K, (len(frames), 1, 1)))


def is_avatarrex(folder: Path) -> bool:
    return (folder / "calibration_full.json").is_file() and (folder / "smpl_params.npz").is_file()


def read_avatarrex(where: str, folder: Path, camera: str | None) -> Recording:
    about = _json(folder / "calibration_full.json")
    name, lens = _chosen(folder, about, camera)
    path = folder / "smpl_params.npz"
    poses = read_arrays(path, "SMPL-X's parameters")
    count = len(poses["transl"])
    images = [p for p in _pictures(folder / _inside(folder, name)) if last_number(p) < count]
    masks = [folder / name / "mask" / "pha" / path.name for path in images]
    both = [k for k, mask in enumerate(masks) if mask.is_file()]
    images, masks = ([paths[k] for k in both] for paths in (images, masks))
    rows = [last_number(path) for path in images]
    given = {key: x[rows] if len(x) == count else x for key, x in poses.items()}
    K = np.tile(_pixels(np.reshape(lens["K"], (3, 3))), (len(rows), 1, 1))
    track = make_track(str(path), "0", np.arange(len(rows)), given, K)
    R, T = np.reshape(lens["R"], (3, 3)), np.ravel(lens["T"])
    track = seen_from(track, R, T.astype(np.float64))
    distortion = np.ravel(lens.get("distCoeff", np.zeros(5)))
    return Recording([track], tuple(images), tuple(masks), distortion, note=_note(name, about))


def _chosen(folder: Path, cameras: Mapping[str, Any], name: str | None) -> tuple[str, Any]:
    """The camera of a name, or the first."""
    if not cameras:
        raise InputError(f"{folder}: names no camera")
    name = next(iter(cameras)) if name is None else name
    if name not in cameras:
        some = ", ".join(list(cameras)[:30])
        raise InputError(f"{folder}: has no camera '{name}'; it has {some}")
    return name, cameras[name]


def _note(name: str, cameras: Mapping[str, Any]) -> str:
    return f"camera {name} of {len(cameras)}; --camera takes another, other views are left out"


def _pixels(K: np.ndarray) -> np.ndarray:
    """OpenCV's K (3, 3), with the centre of the first pixel at 0.5."""
    return np.asarray(K, np.float64) + np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])


def _pictures(folder: Path) -> tuple[Path, ...]:
    """A camera's pictures, by number."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder of pictures")
    files = [path for path in folder.iterdir() if path.suffix.lower() in _JPG]
    return tuple(sorted(files, key=last_number))


def _json(path: Path) -> Any:  # noqa: ANN401
    return read_json(path, "what the data set holds there")


def _yaml(path: Path) -> dict[str, np.ndarray]:
    """The matrices of a file of OpenCV's, by name."""
    found = {}
    for name, rows, cols, data in _MATRIX.findall(path.read_text(errors="replace")):
        found[name] = np.array([float(x) for x in data.split(",")]).reshape(int(rows), int(cols))
    return found
