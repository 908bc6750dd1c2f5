"""Data sets that many cameras filmed; one of them, ``--camera``, becomes the video.

=============  ====================================================  ===========================
Kind           Folder, by the public repository's own code           Cameras
=============  ====================================================  ===========================
``zju``        ``annots.npy``, ``new_params/`` or ``params/``,       ``K``, ``D``, ``R``, and
               ``mask_cihp/`` or ``mask/`` (zju3dv/neuralbody)       ``T`` in millimetres
``easymocap``  ``intri.yml``, ``extri.yml``, ``images/1/``,          ``K_1``, ``dist_1``,
               ``mask/1/``, and ``smpl/000000.json`` of SMPL,        ``Rot_1``, ``T_1``
               SMPL+H or SMPL-X
               (zju3dv/EasyMocap)
``avatarrex``  ``calibration_full.json``, ``smpl_params.npz``,       ``K``, ``R``, ``T``
               ``22010708/`` with ``mask/pha/``
               (lizhe00/AnimatableGaussians)
=============  ====================================================  ===========================

EasyMocap's body turns about the origin, x = R(Rh) b + Th, and not about its pelvis p, so that its
translation here is R(Rh) p + Th − p. OpenCV, by which all are calibrated, has the centre of the
first pixel at 0 and not at 0.5.

What others saw at the same time can be held out: :mod:`.other_views`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import roma
import torch

from gva_mi.data.importers.fields import decoded
from gva_mi.data.importers.frame_files import plain
from gva_mi.data.importers.readings import PELVIS, make_track, seen_from
from gva_mi.data.importers.recordings import OtherCamera, Recording, Wanted
from gva_mi.data.importers.tracks import Track
from gva_mi.data.importers.whole_videos import last_number
from gva_mi.errors import InputError
from gva_mi.files import read_arrays, read_json
from gva_mi.pickles.reader import read_objects

_SMPL = (
    "output-smpl-3d/smpl", "output-smpl-3d/smplfull", "output/smplx/smpl", "output/smplh/smpl",
    "output/smpl/smpl", "output/smpl", "smpl",
)  # fmt: skip
_MATRIX = re.compile(
    r"^(\w[\w.\-]*): *!!opencv-matrix\s+rows: *(\d+)\s+cols: *(\d+)\s+dt: *\w+\s+"
    r"data: *\[([^\]]*)\]",
    re.M,
)
_JPG = (".jpg", ".jpeg", ".png")


def is_zju(folder: Path) -> bool:
    return (folder / "annots.npy").is_file()


def read_zju(where: str, folder: Path, wanted: Wanted) -> Recording:
    found = plain(read_objects(folder / "annots.npy", "cams and ims, as ZJU-MoCap has them"))
    cameras = {
        str(k): partial(_zju_camera, folder, found, k) for k in range(len(found["cams"]["K"]))
    }
    name, own = _chosen(folder, cameras, wanted.camera)
    params = next((p for p in ("new_params", "params") if (folder / p).is_dir()), "new_params")
    people = []
    for path in own.frames.values():
        path = folder / params / f"{_zju_number(path.name)}.npy"
        people.append(plain(read_objects(path, "poses, shapes, Rh and Th of a frame")))
    track = _turned_about_origin(where, "0", np.arange(len(people)), people, own.K)
    numbers = list(own.frames)
    masks = tuple(own.masks[k] for k in numbers)
    recording = Recording([seen_from(track, own.R, own.T)], tuple(own.frames.values()), masks)
    return replace(_among(recording, name, own, cameras, numbers), labels=True)


def _zju_camera(folder: Path, found: Mapping[str, Any], k: int) -> OtherCamera:
    """The k-th camera; frames go by their place in the list."""
    lens = {key: np.asarray(found["cams"][key][k], np.float64) for key in "KDRT"}
    names = [_inside(folder, frame["ims"][k]) for frame in found["ims"]]
    masks = next((m for m in ("mask_cihp", "mask") if (folder / m).is_dir()), "mask_cihp")
    return OtherCamera(
        frames={i: folder / name for i, name in enumerate(names)},
        masks={i: (folder / masks / name).with_suffix(".png") for i, name in enumerate(names)},
        K=_pixels(lens["K"]), R=lens["R"].reshape(3, 3), T=lens["T"].ravel() / 1000,
        distortion=lens["D"].ravel(),
    )  # fmt: skip


def _among(
    recording: Recording,
    name: str,
    own: OtherCamera,
    cameras: Mapping[str, Callable[[], OtherCamera]],
    numbers: Sequence[int],
) -> Recording:
    """A recording of one camera, with the others beside it."""
    note = f"camera {name} of {len(cameras)}; --camera takes another, --views holds others out"
    others = {other: read for other, read in cameras.items() if other != name}
    return replace(
        recording, distortion=own.distortion, note=note, own=own, others=others, numbers=numbers
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


def read_easymocap(where: str, folder: Path, wanted: Wanted) -> Recording:
    inner, outer = (_yaml(folder / name) for name in ("intri.yml", "extri.yml"))
    cameras = {
        key[2:]: partial(_easymocap_camera, folder, inner, outer, key[2:])
        for key in inner
        if key.startswith("K_")
    }
    name, own = _chosen(folder, cameras, wanted.camera)
    params = next((folder / p for p in _SMPL if (folder / p).is_dir()), None)
    if params is None:
        raise InputError(f"{folder}: has none of {', '.join(_SMPL)}, with a .json a frame")
    people: dict[str, list[tuple[int, Mapping[str, Any]]]] = {}
    for path in sorted(params.glob("*.json"), key=last_number):
        frame = _json(path)
        for person in frame["annots"] if isinstance(frame, dict) else frame:
            people.setdefault(str(person.get("id", 0)), []).append((last_number(path), person))
    numbers = list(own.frames)
    places = {number: k for k, number in enumerate(numbers)}
    tracks = []
    for person, seen in people.items():
        kept = [(places[number], params) for number, params in seen if number in places]
        if kept:
            at, frames = f"{params}: person {person}", np.array([frame for frame, _ in kept])
            each = [params for _, params in kept]
            track = _turned_about_origin(at, person, frames, each, own.K, wanted.components)
            tracks.append(seen_from(track, own.R, own.T))
    recording = Recording(tracks, tuple(own.frames.values()), tuple(own.masks.values()) or None)
    return _among(recording, name, own, cameras, numbers)


def _easymocap_camera(
    folder: Path, inner: Mapping[str, np.ndarray], outer: Mapping[str, np.ndarray], name: str
) -> OtherCamera:
    by_number = lambda paths: {last_number(path): path for path in paths}
    masks = folder / "mask" / _inside(folder, name)
    if f"Rot_{name}" in outer:
        R = outer[f"Rot_{name}"]
    else:
        R = roma.rotvec_to_rotmat(torch.from_numpy(np.ravel(outer[f"R_{name}"]))).numpy()
    return OtherCamera(
        frames=by_number(_pictures(folder / "images" / _inside(folder, name))),
        masks=by_number(_pictures(masks)) if masks.is_dir() else {},
        K=_pixels(inner[f"K_{name}"]), R=R, T=np.ravel(outer[f"T_{name}"]),
        distortion=np.ravel(inner.get(f"dist_{name}", inner.get(f"D_{name}", np.zeros(5)))),
    )  # fmt: skip


def _turned_about_origin(
    where: str,
    person: str,
    frames: np.ndarray,
    each: Sequence[Mapping[str, Any]],
    K: np.ndarray,
    components: np.ndarray | None = None,
) -> Track:
    """EasyMocap's parameters, of SMPL, SMPL+H or SMPL-X, as a track in its world."""
    rows = lambda name: np.stack([np.ravel(np.asarray(p[name], np.float64)) for p in each])
    poses, turns, places = rows("poses"), rows("Rh"), rows("Th")
    hands = [rows(name) for name in ("handl", "handr") if all(name in p for p in each)]
    poses, form = _easymocaps_poses(where, poses, hands, "expression" in each[0], components)
    turns = torch.from_numpy(turns)
    roots = torch.from_numpy(poses[:, :3].copy())
    poses[:, :3] = roma.rotvec_composition([turns, roots]).numpy()
    pelvis = np.array(PELVIS[form])
    transl = roma.rotvec_to_rotmat(turns).numpy() @ pelvis + places - pelvis
    given = {"poses": poses, "transl": transl, "betas": rows("shapes")}
    track = make_track(where, person, frames, given, np.tile(K, (len(frames), 1, 1)))
    return replace(track, from_mean_hand=bool(hands))


def _easymocaps_poses(
    where: str,
    poses: np.ndarray,
    hands: Sequence[np.ndarray],
    has_face: bool,
    components: np.ndarray | None,
) -> tuple[np.ndarray, str]:
    """Poses (n, 72, 156 or 165) and whose they are, of what the files hold.

    ==============================  ==========================================================
    69, 72                          SMPL without or with the root
    78, 87: 66 + 6 + 6 (+ 9)        SMPL+H, SMPL-X: components of the hands, relative to the
                                    flat one, and jaw and eyes
    156, 165                        the same, joint by joint
    63, 66 with ``handl, handr``    SMPL+H, or SMPL-X where there is an ``expression``: hands
                                    relative to the mean one
    ==============================  ==========================================================
    """
    count = poses.shape[1]
    if count in (63, 69):
        poses = np.concatenate([np.zeros((len(poses), 3)), poses], axis=1)
    body, face = poses[:, :66], np.zeros((len(poses), 9 if has_face or count in (87, 165) else 0))
    if count in (69, 72):
        return poses, "SMPL"
    if count in (78, 87):
        hands, face = (poses[:, 66:72], poses[:, 72:78]), poses[:, 78:]
    elif count in (156, 165):
        return poses, "SMPL-X" if count == 165 else "SMPL+H"
    elif count not in (63, 66) or len(hands) != 2:
        raise InputError(
            f"{where}: 'poses' has {count} numbers a frame; expected SMPL's 72 or 69, SMPL+H's 78 "
            "or 156, SMPL-X's 87 or 165, or 66 beside handl and handr"
        )
    fingers = [decoded(where, hand, side, components) for side, hand in enumerate(hands)]
    whole = np.concatenate([body, face, *fingers], axis=1)
    return whole, "SMPL-X" if face.shape[1] else "SMPL+H"


def is_avatarrex(folder: Path) -> bool:
    return (folder / "calibration_full.json").is_file() and (folder / "smpl_params.npz").is_file()


def read_avatarrex(where: str, folder: Path, wanted: Wanted) -> Recording:
    about = _json(folder / "calibration_full.json")
    cameras = {key: partial(_avatarrex_camera, folder, key, lens) for key, lens in about.items()}
    name, own = _chosen(folder, cameras, wanted.camera)
    path = folder / "smpl_params.npz"
    poses = read_arrays(path, "SMPL-X's parameters")
    count = len(poses["transl"])
    rows = [k for k in own.frames if k < count and k in own.masks]
    given = {key: x[rows] if len(x) == count else x for key, x in poses.items()}
    K = np.tile(own.K, (len(rows), 1, 1))
    track = seen_from(make_track(str(path), "0", np.arange(len(rows)), given, K), own.R, own.T)
    images, masks = (tuple(paths[k] for k in rows) for paths in (own.frames, own.masks))
    return _among(Recording([track], images, masks), name, own, cameras, rows)


def _avatarrex_camera(folder: Path, name: str, lens: Mapping[str, Any]) -> OtherCamera:
    frames = {last_number(path): path for path in _pictures(folder / _inside(folder, name))}
    masks = {k: folder / name / "mask" / "pha" / path.name for k, path in frames.items()}
    return OtherCamera(
        frames, {k: path for k, path in masks.items() if path.is_file()},
        K=_pixels(np.reshape(lens["K"], (3, 3))), R=np.reshape(lens["R"], (3, 3)),
        T=np.ravel(lens["T"]).astype(np.float64),
        distortion=np.ravel(lens.get("distCoeff", np.zeros(5))),
    )  # fmt: skip


def _chosen(
    folder: Path, cameras: Mapping[str, Callable[[], OtherCamera]], name: str | None
) -> tuple[str, OtherCamera]:
    """The camera of a name, or the first."""
    if not cameras:
        raise InputError(f"{folder}: names no camera")
    name = next(iter(cameras)) if name is None else name
    if name not in cameras:
        some = ", ".join(list(cameras)[:30])
        raise InputError(f"{folder}: has no camera '{name}'; it has {some}")
    return name, cameras[name]()


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
