"""Hashes that identify the video a run was fitted to.

Poses trained on one video mean nothing in another, though it may have as many frames. So a run
keeps the hashes of :data:`PARTS`, and reports which differ. Files are hashed as they are: a video
that was encoded again is another one, even if lossless.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np

from gva_mi.data.video import Video

PARTS = ("frames", "masks", "cameras", "poses", "splits")
_BLOCK = 1 << 20  # bytes read at once


def identity(video: Video) -> dict[str, str]:
    """Hash each of :data:`PARTS`; poses are those that the video was opened with."""
    folder, pose = video.folder, video.pose
    pictures = sorted((folder / "frames").glob("*.png")) or [folder / "video.mp4"]
    cameras = [x for c in video.cameras for x in (c.K, c.T_camera_world, [c.width, c.height])]
    poses = [pose.rotations, pose.transl, pose.expression, video.shape.betas]
    splits = [video.splits.train, [-1], video.splits.test]
    return {
        "frames": _of_files(pictures),
        "masks": _of_files(sorted(p for p in (folder / "masks").glob("*") if p.is_file())),
        "cameras": of_arrays(cameras),
        "poses": of_arrays(x.detach().numpy() for x in poses),
        "splits": of_arrays(splits),
    }


def differing(known: Mapping[str, str], video: Video) -> list[str]:
    """Those of :data:`PARTS` in which a video differs from a run's; none without a record."""
    if not known:
        return []
    found = identity(video)
    return [part for part in PARTS if found[part] != known.get(part)]


def _of_files(paths: Iterable[Path]) -> str:
    """Hash files, their names and their order."""
    total = hashlib.blake2b(digest_size=16)
    for path in paths:
        total.update(f"{path.name}:{path.stat().st_size}\n".encode())
        with path.open("rb") as file:
            while block := file.read(_BLOCK):
                total.update(block)
    return total.hexdigest()


def of_arrays(arrays: Iterable[object]) -> str:
    """Hash numbers or words, and their shapes."""
    total = hashlib.blake2b(digest_size=16)
    for array in map(np.asarray, arrays):
        total.update(f"{array.shape}:{array.dtype}\n".encode())
        total.update(np.ascontiguousarray(array).tobytes())
    return total.hexdigest()
