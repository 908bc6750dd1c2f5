"""People-Snapshot: somebody turns before a camera that stands still.

=================  ================================================  ==========================
Kind               Folder, by the public repository's own code       Poses
=================  ================================================  ==========================
``snapshot``       ``camera.pkl``, ``masks.hdf5``, the film, and     ``pose``, ``trans``, SMPL
                   ``reconstructed_poses.hdf5``
                   (thmoa/videoavatars)
``instantavatar``  ``cameras.npz``, ``images/``, ``masks/``, and     ``thetas`` or parts of
                   ``poses.npz`` (tijiang13/InstantAvatar); its      SMPL's; ``transl``
                   ``anim_nerf`` poses are of parts of the frames
=================  ================================================  ==========================

Poses are of a world, which the camera's ``camera_rt`` and ``camera_t``, or its ``extrinsic``, take
to the camera. InstantAvatar's pictures have the distortion taken out already.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import roma
import torch

from gva_mi.data.importers.footage import PICTURES
from gva_mi.data.importers.hdf5 import read_hdf5
from gva_mi.data.importers.readings import make_track, seen_from
from gva_mi.data.importers.recordings import Recording, Wanted
from gva_mi.errors import InputError
from gva_mi.files import read_arrays, require_keys
from gva_mi.pickles.reader import read_objects

FILMS = (".mp4", ".mov", ".avi", ".mkv")
_POSES, _MASKS = "reconstructed_poses.hdf5", "masks.hdf5"


def is_snapshot(folder: Path) -> bool:
    return (folder / "camera.pkl").is_file() and (folder / _POSES).is_file()


def read_snapshot(where: str, folder: Path, wanted: Wanted) -> Recording:
    films = sorted(path for path in folder.iterdir() if path.suffix.lower() in FILMS)
    if len(films) != 1:
        raise InputError(f"{folder}: holds {len(films)} films; expected one, such as a .mp4")
    lens = read_objects(folder / "camera.pkl", "camera_f, camera_c, camera_k, camera_rt, camera_t")
    (fx, fy), (cx, cy) = (np.ravel(lens[name]) for name in ("camera_f", "camera_c"))
    poses = {name: read_hdf5(folder / _POSES, name) for name in ("pose", "trans", "betas")}
    frames = np.arange(len(poses["pose"]))
    K = np.tile(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float64), (len(frames), 1, 1))
    track = make_track(str(folder / _POSES), "0", frames, poses, K)
    turn = torch.from_numpy(np.ravel(lens["camera_rt"]).astype(np.float64))
    T = np.ravel(lens["camera_t"]).astype(np.float64)
    track = seen_from(track, roma.rotvec_to_rotmat(turn).numpy(), T)
    k = np.ravel(lens["camera_k"]).astype(np.float64)
    return Recording([track], films[0], folder / _MASKS, k, loose=True)


def is_instantavatar(folder: Path) -> bool:
    return all((folder / name).exists() for name in ("cameras.npz", "images", "masks")) and any(
        (folder / name).is_file() for name in ("poses.npz", "poses_optimized.npz")
    )


def read_instantavatar(where: str, folder: Path, wanted: Wanted) -> Recording:
    lens = read_arrays(folder / "cameras.npz", "intrinsic and extrinsic")
    require_keys(folder / "cameras.npz", lens, ("intrinsic", "extrinsic"))
    path = folder / "poses_optimized.npz"
    path = path if path.is_file() else folder / "poses.npz"
    poses = read_arrays(path, "thetas, transl and betas")
    require_keys(path, poses, ("transl", "betas"))
    frames = np.arange(len(poses["transl"]))
    K = np.tile(np.asarray(lens["intrinsic"], np.float64)[:3, :3], (len(frames), 1, 1))
    track = make_track(str(path), "0", frames, poses, K)
    T = np.asarray(lens["extrinsic"], np.float64)
    track = seen_from(track, T[:3, :3], T[:3, 3])
    images = tuple(p for p in sorted((folder / "images").iterdir()) if p.suffix.lower() in PICTURES)
    if not images:
        raise InputError(f"{folder / 'images'}: holds no pictures ({', '.join(PICTURES)})")
    return Recording([track], images, folder / "masks", loose=True)
