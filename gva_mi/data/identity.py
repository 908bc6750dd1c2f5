"""Identify a video by hashes of what a fit sees of it, which are kept with the run.

Poses trained on one video mean nothing in another, even one with as many frames. Files are hashed
as they are: a re-encoded video is another video, even if the encoding is lossless.
"""

from __future__ import annotations

from collections.abc import Mapping

from gva_mi.core.provenance import hash_arrays, hash_files
from gva_mi.data.video import Video

PARTS = ("frames", "masks", "cameras", "poses", "splits")


def identity(video: Video) -> dict[str, str]:
    """Return a hash of each of :data:`PARTS`; poses are those the video was opened with."""
    folder, pose = video.folder, video.pose
    pictures = sorted((folder / "frames").glob("*.png")) or [folder / "video.mp4"]
    cameras = [x for c in video.cameras for x in (c.K, c.T_camera_world, [c.width, c.height])]
    poses = [pose.rotations, pose.transl, pose.expression, video.shape.betas]
    splits = [video.splits.train, [-1], video.splits.test]
    return {
        "frames": hash_files(pictures),
        "masks": hash_files(sorted(p for p in (folder / "masks").glob("*") if p.is_file())),
        "cameras": hash_arrays(cameras),
        "poses": hash_arrays(x.detach().numpy() for x in poses),
        "splits": hash_arrays(splits),
    }


def differing(known: Mapping[str, str], video: Video) -> list[str]:
    """Return the :data:`PARTS` in which a video differs from a record; none if that is empty."""
    if not known:
        return []
    found = identity(video)
    return [part for part in PARTS if found[part] != known.get(part)]
