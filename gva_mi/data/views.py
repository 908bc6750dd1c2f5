"""Held-out views: frames of a video from other cameras at the same time, for evaluation only.

::

    subject/
      views/
        frames/000000.png ...   8-bit RGB
        masks/000000.png ...    of the same person
        cameras.npz             a camera for each of these pictures, in the subject's world
        views.json              {"frames": [...], "cameras": [...]}: which frame of the video each
                                picture is of, and the name of the camera that saw it

Poses are those that the video was opened with. Only evaluation reads this folder. (Synthetic
subjects have their novel views in the ground truth.)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from gva_mi.core.errors import InputError, expecting
from gva_mi.core.files import read_json, write_json
from gva_mi.data.cameras import load_cameras, save_cameras
from gva_mi.data.folder import CAMERAS, FRAMES, MASKS, VIEWS, frame_name
from gva_mi.data.masks import read_mask
from gva_mi.data.pictures import read_image, require_sides
from gva_mi.data.splits import Splits
from gva_mi.data.video import Video
from gva_mi.splat import Camera

ABOUT = "views.json"


def held_out_views(video: Video) -> Video | None:
    """Read the held-out views of a video, with its poses; None without such views."""
    found = read_views(video.folder, len(video))
    if found is None:
        return None
    frames, cameras = found
    return replace(
        video, folder=video.folder / VIEWS, cameras=cameras, pose=video.pose[frames], normals=None,
        absent={}, splits=Splits([], list(range(len(frames)))), _images=[],
    )  # fmt: skip


def read_views(subject: Path, count: int) -> tuple[list[int], list[Camera]] | None:
    """Read frame (of ``count``) and camera of each held-out picture; None without such views."""
    folder = subject / VIEWS
    if not folder.is_dir():
        return None
    path, expected = folder / ABOUT, '{"frames": [...]}, the video\'s frame of each picture'
    found = read_json(path, expected)
    with expecting(path, expected):
        frames = found["frames"]
        if not frames or not all(type(k) is int and 0 <= k < count for k in frames):
            raise ValueError(f"the video has frames 0 to {count - 1}")
    cameras = load_cameras(folder / CAMERAS, len(frames), f" for {{}} pictures of {ABOUT}")
    for k, camera in enumerate(cameras):
        image = read_image(folder / FRAMES / frame_name(k), 3)
        mask = read_mask(folder / MASKS, k)
        if mask is None:
            raise InputError(f"{folder}: mask {k} is not there")
        for what, found in (("picture", image), ("mask", mask)):
            require_sides(f"{folder}: {what} {k}", found, camera.width, camera.height)
    return frames, cameras


def save_views(
    folder: Path, frames: Sequence[int], names: Sequence[str], cameras: Sequence[Camera]
) -> None:
    """Write ``views.json`` and ``cameras.npz``: frame and camera of each picture."""
    save_cameras(folder / CAMERAS, cameras)
    write_json(folder / ABOUT, {"frames": list(frames), "cameras": list(names)})
