"""Data sets that one camera filmed: People-Snapshot, InstantAvatar's form of it, ExAvatar's folder.

=================  =================================================  ========================
Kind               Folder, by the public repository's own code        Camera
=================  =================================================  ========================
``snapshot``       ``masks.hdf5``, the film, and                      ``camera.pkl``
                   ``reconstructed_poses.hdf5`` of SMPL
                   (thmoa/videoavatars)
``instantavatar``  ``images/``, ``masks/``, and ``poses.npz``, or     ``cameras.npz``, without
                   ``poses_optimized.npz`` (tijiang13/InstantAvatar)  distortion
``exavatar``       ``frames/12.png``, ``masks/12.png``, and           ``cam_params/12.json``:
                   ``smplx_optimized/smplx_params_smoothed/12.json``  ``R``, ``t``, ``focal``,
                   with ``shape_param.json`` (mks0601/ExAvatar)       ``princpt``
=================  =================================================  ========================

Poses are of a world, which the camera's pose takes to the camera. ExAvatar's is what is publicly
known of the kind of folder that the paper calls GVA-Snapshot; its offsets of joints and face belong
to its own body and are left out.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from gva_mi.core.errors import InputError
from gva_mi.core.files import read_arrays, read_json, require_keys
from gva_mi.core.pickles.reader import read_objects
from gva_mi.data.importers import smplx_json
from gva_mi.data.importers.capture import Capture
from gva_mi.data.importers.estimator_files import stacked
from gva_mi.data.importers.footage import files_of
from gva_mi.data.importers.hdf5 import read_hdf5
from gva_mi.data.importers.lens import CAMERA, lens_in, pinhole_K
from gva_mi.data.importers.rotations import to_matrices
from gva_mi.data.importers.tracks import make_track
from gva_mi.data.video import Splits

FILMS = (".mp4", ".mov", ".avi", ".mkv")
_EXAVATAR = ("smplx_optimized/smplx_params_smoothed", "smplx_optimized/smplx_params")


def snapshot(where: str, folder: Path, camera: str | None) -> Capture:
    films = sorted(path for path in folder.iterdir() if path.suffix.lower() in FILMS)
    if len(films) != 1:
        raise InputError(f"{folder}: holds {len(films)} films; expected one, such as a .mp4")
    lens = read_objects(folder / "camera.pkl", "camera_f, camera_c, camera_k, camera_rt, camera_t")
    path = folder / "reconstructed_poses.hdf5"
    poses = {name: read_hdf5(path, name) for name in ("pose", "trans", "betas")}
    track = make_track(str(path), "0", None, poses, pinhole_K(lens["camera_f"], lens["camera_c"]))
    R, T, k = (np.ravel(lens[f"camera_{x}"]).astype(np.float64) for x in ("rt", "t", "k"))
    track = track.seen_from(to_matrices(R), T)
    return Capture([track], films[0], folder / "masks.hdf5", k, loose=True)


def instantavatar(where: str, folder: Path, camera: str | None) -> Capture:
    path = folder / "cameras.npz"
    lens = read_arrays(path, "intrinsic and extrinsic")
    require_keys(path, lens, ("intrinsic", "extrinsic"))
    path = folder / "poses_optimized.npz"
    path = path if path.is_file() else folder / "poses.npz"
    poses = read_arrays(path, "thetas, transl and betas")
    require_keys(path, poses, ("transl", "betas"))
    K, T = (np.asarray(lens[name], np.float64) for name in ("intrinsic", "extrinsic"))
    track = make_track(str(path), "0", None, poses, K[:3, :3]).seen_from(T[:3, :3], T[:3, 3])
    images = tuple(files_of(folder / "images"))
    return Capture([track], images, folder / "masks", loose=True)


def exavatar(where: str, folder: Path, camera: str | None) -> Capture:
    poses = next((folder / name for name in _EXAVATAR if (folder / name).is_dir()), None)
    if poses is None:
        raise InputError(f"{folder}: has none of {', '.join(_EXAVATAR)}, with a .json a frame")
    numbers = sorted(int(path.stem) for path in poses.glob("*.json") if path.stem.isdecimal())
    numbers = [k for k in numbers if (folder / f"frames/{k}.png").is_file()]
    if not numbers:
        raise InputError(f"{poses}: no file has the number of a picture in {folder / 'frames'}")
    lenses = [folder / f"cam_params/{k}.json" for k in numbers]
    about = [read_json(path, CAMERA) for path in lenses]
    rows = (("0", k, smplx_json.parameters(poses / f"{k}.json")) for k in numbers)
    (person,) = stacked(poses, rows)
    betas = folder / "smplx_optimized/shape_param.json"
    betas = np.ravel(np.asarray(read_json(betas, "the person's betas, numbers"), np.float64))
    K = np.stack([lens_in(path, found) for path, found in zip(lenses, about, strict=True)])
    track = make_track(str(poses), "0", None, {**person.arrays, "betas": betas}, K)
    R, T = (
        np.stack([np.reshape(x.get(key, other), np.shape(other)) for x in about]).astype(np.float64)
        for key, other in (("R", np.eye(3)), ("t", np.zeros(3)))
    )
    track = replace(track.seen_from(R, T), from_mean_hand=track.has_hands)
    images, masks = (tuple(folder / f"{x}/{k}.png" for k in numbers) for x in ("frames", "masks"))
    note = "offsets of joints and face are ExAvatar's own, and left out"
    return Capture([track], images, masks, splits=_splits(folder, numbers), note=note)


def _splits(folder: Path, numbers: list[int]) -> Splits | None:
    """ExAvatar's two lists of frames, where both are there."""
    paths = [folder / f"frame_list_{name}.txt" for name in ("train", "test")]
    if not all(path.is_file() for path in paths):
        return None
    places = {number: k for k, number in enumerate(numbers)}
    lists = []
    for path in paths:
        words = path.read_text(errors="replace").split()
        if not all(word.isdecimal() for word in words):
            raise InputError(f"{path}: expected the number of a frame in each line")
        lists.append([places[int(word)] for word in words if int(word) in places])
    return Splits(*lists)
