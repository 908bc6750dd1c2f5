"""ExAvatar's folder of a video: frames, masks, and SMPL-X fitted to them.

============  ================================================  =========================
Kind          Folder, by the public repository's own code       Camera
============  ================================================  =========================
``exavatar``  ``frames/12.png``, ``masks/12.png``, and          ``cam_params/12.json``:
              ``smplx_optimized/smplx_params_smoothed/12.json`` ``R``, ``t``, ``focal``,
              with ``shape_param.json`` (mks0601/ExAvatar)      ``princpt``
============  ================================================  =========================

It is what is publicly known of the kind of folder that the paper calls GVA-Snapshot: pictures,
masks and SMPL-X by frame. Its offsets of joints and of the face are of its own body, and are left
out. ``frame_list_train.txt`` and ``frame_list_test.txt`` are its protocol.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from gva_mi.data.importers.readings import make_track, seen_from
from gva_mi.data.importers.recordings import Recording, Wanted
from gva_mi.data.importers.smplx_json import CAMERA, PARAMETERS, parameters, pinhole_of
from gva_mi.data.video import Splits
from gva_mi.errors import InputError
from gva_mi.files import read_json

_POSES = ("smplx_optimized/smplx_params_smoothed", "smplx_optimized/smplx_params")
_SHAPE = "smplx_optimized/shape_param.json"


def is_exavatar(folder: Path) -> bool:
    return (folder / _SHAPE).is_file() and (folder / "frames").is_dir()


def read_exavatar(where: str, folder: Path, wanted: Wanted) -> Recording:
    poses = next((folder / name for name in _POSES if (folder / name).is_dir()), None)
    if poses is None:
        raise InputError(f"{folder}: has none of {', '.join(_POSES)}, with a .json a frame")
    numbers = sorted(int(path.stem) for path in poses.glob("*.json") if path.stem.isdecimal())
    numbers = [k for k in numbers if (folder / f"frames/{k}.png").is_file()]
    if not numbers:
        raise InputError(f"{poses}: no file has the number of a picture in {folder / 'frames'}")
    given = parameters(str(poses), [read_json(poses / f"{k}.json", PARAMETERS) for k in numbers])
    betas = read_json(folder / _SHAPE, "the shape of the person, a list of numbers")
    given["betas"] = np.ravel(np.asarray(betas, np.float64))
    cameras = [folder / f"cam_params/{k}.json" for k in numbers]
    found = [read_json(path, CAMERA) for path in cameras]
    K = np.stack([pinhole_of(str(p), about) for p, about in zip(cameras, found, strict=True)])
    track = make_track(str(poses), "0", np.arange(len(numbers)), given, K)
    R = np.stack([np.reshape(about.get("R", np.eye(3)), (3, 3)) for about in found])
    T = np.stack([np.reshape(about.get("t", np.zeros(3)), 3) for about in found])
    R, T = R.astype(np.float64), T.astype(np.float64)
    track = replace(seen_from(track, R, T), from_mean_hand=track.has_hands)
    pictures, masks = (
        tuple(folder / f"{part}/{k}.png" for k in numbers) for part in ("frames", "masks")
    )
    note = "offsets of joints and face are ExAvatar's own, and left out"
    return Recording([track], pictures, masks, splits=_splits(folder, numbers), note=note)


def _splits(folder: Path, numbers: list[int]) -> Splits | None:
    """Of the two lists of frames, where both are there."""
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
