"""Readers of one-camera data sets: InstantAvatar's form of People-Snapshot, ExAvatar's folder.

Their forms are those of the public code of tijiang13/InstantAvatar and mks0601/ExAvatar;
``docs/sources.md`` lists the files. Poses are of a world, which the camera's pose takes to the
camera. ExAvatar's folder is what is publicly known of the kind that the paper calls GVA-Snapshot;
its offsets of joints and face belong to its own body and are left out.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from gva_mi.core.errors import InputError
from gva_mi.core.files import read_arrays, read_json, require_keys
from gva_mi.data.importers.capture import Capture
from gva_mi.data.importers.estimator_files import stacked
from gva_mi.data.importers.footage import files_of
from gva_mi.data.importers.frame_files import osx_parameters
from gva_mi.data.importers.lens import CAMERA, lens_in
from gva_mi.data.importers.target import TargetBody
from gva_mi.data.importers.tracks import make_track
from gva_mi.data.splits import Splits

_EXAVATAR = ("smplx_optimized/smplx_params_smoothed", "smplx_optimized/smplx_params")


def instantavatar(where: str, folder: Path, camera: str | None, body: TargetBody) -> Capture:
    path = folder / "cameras.npz"
    lens = read_arrays(path, "intrinsic and extrinsic")
    require_keys(path, lens, ("intrinsic", "extrinsic"))
    path = folder / "poses_optimized.npz"
    path = path if path.is_file() else folder / "poses.npz"
    poses = read_arrays(path, "thetas, transl and betas")
    require_keys(path, poses, ("transl", "betas"))
    K, T = (np.asarray(lens[name], np.float64) for name in ("intrinsic", "extrinsic"))
    track = make_track(str(path), "0", None, poses, K[:3, :3], body)
    track = track.seen_from(T[:3, :3], T[:3, 3])
    images = tuple(files_of(folder / "images"))
    return Capture([track], images, folder / "masks", loose=True)


def exavatar(where: str, folder: Path, camera: str | None, body: TargetBody) -> Capture:
    poses = next((folder / name for name in _EXAVATAR if (folder / name).is_dir()), None)
    if poses is None:
        raise InputError(f"{folder}: has none of {', '.join(_EXAVATAR)}, with a .json a frame")
    numbers = sorted(int(path.stem) for path in poses.glob("*.json") if path.stem.isdecimal())
    numbers = [k for k in numbers if (folder / f"frames/{k}.png").is_file()]
    if not numbers:
        raise InputError(f"{poses}: no file has the number of a picture in {folder / 'frames'}")
    lenses = [folder / f"cam_params/{k}.json" for k in numbers]
    about = [read_json(path, CAMERA) for path in lenses]
    of_frame = lambda path: osx_parameters(path, read_json(path, "SMPL-X's parameters of a frame"))
    rows = (("0", k, of_frame(poses / f"{k}.json")) for k in numbers)
    (person,) = stacked(poses, rows)
    betas = folder / "smplx_optimized/shape_param.json"
    betas = np.ravel(np.asarray(read_json(betas, "the person's betas, numbers"), np.float64))
    K = np.stack([lens_in(path, found) for path, found in zip(lenses, about, strict=True)])
    track = make_track(str(poses), "0", None, {**person.arrays, "betas": betas}, K, body)
    R, T = (
        np.stack([np.reshape(x.get(key, other), np.shape(other)) for x in about]).astype(np.float64)
        for key, other in (("R", np.eye(3)), ("t", np.zeros(3)))
    )
    track = replace(track.seen_from(R, T), from_mean_hand=track.has_hands)
    images, masks = (tuple(folder / f"{x}/{k}.png" for k in numbers) for x in ("frames", "masks"))
    note = "offsets of joints and face are ExAvatar's own, and left out"
    return Capture([track], images, masks, splits=_splits(folder, numbers), note=note)


def _splits(folder: Path, numbers: list[int]) -> Splits | None:
    """Read ExAvatar's lists of train and test frames, if both exist."""
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
