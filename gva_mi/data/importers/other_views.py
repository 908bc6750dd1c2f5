"""Write other cameras of a data set as held-out views: :mod:`gva_mi.data.ground_truth`.

With E = [R T] of a camera in the data set's world, and the video's camera turned upright by W,

    E_subject = E E_video⁻¹ W.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gva_mi.body.rotations import nearest_rotations
from gva_mi.core.errors import InputError, expecting
from gva_mi.data.folder import FRAMES, MASKS, VIEWS, frame_name
from gva_mi.data.ground_truth import save_views
from gva_mi.data.importers.capture import Capture, FixedCamera
from gva_mi.data.importers.footage import pictures
from gva_mi.data.importers.lens import undistort
from gva_mi.data.pictures import require_sides, write_image
from gva_mi.data.splits import spread
from gva_mi.splat import Camera

ALL = "all"  # in the place of names


def known_names(where: str, capture: Capture, names: Sequence[str]) -> list[str]:
    """Return the names of the held-out cameras; "all" in ``names`` means every other camera."""
    there = capture.others
    names = list(there) if list(names) == [ALL] and there else list(names)
    for name in names:
        if name not in there:
            some = ", ".join(list(there)[:30]) or "none"
            raise InputError(f"{where}: has no other camera '{name}' to hold out; it has {some}")
    return names


def write_views(
    out: Path,
    where: str,
    capture: Capture,
    names: Sequence[str],
    frames: Sequence[int],
    each: int,
    upright: np.ndarray,
) -> list[str]:
    """Write ``views/`` of the folder ``out``, and return notes.

    Each camera of ``names`` sees at most ``each`` of ``frames``, evenly spaced; ``upright`` is W
    (4, 4).
    """
    T_video = np.linalg.inv(_extrinsic(capture.own)) @ upright
    shown: list[tuple[int, str, Camera]] = []  # frame, name and camera of each picture
    left_out = []
    for name in names:
        at = f"{where}: camera {name}"
        with expecting(at, "K, R, T and its pictures, as the first camera has them"):
            other = capture.others[name]()
            T = _extrinsic(other) @ T_video
            Camera.from_matrices(other.K, T, 1, 1)  # refuses what no camera has
        for k in spread([k for k in frames if _is_there(other, capture.numbers[k])], each):
            image, mask = _pair(other, capture.numbers[k], capture)
            size = image.shape[1::-1]
            if shown and size != (shown[0][2].width, shown[0][2].height):
                left_out.append(name)
                break
            straight = undistort(at, other.K, other.distortion, size) or (lambda image: image)
            for part, picture in ((FRAMES, image), (MASKS, mask)):
                write_image(out / VIEWS / part / frame_name(len(shown)), straight(picture))
            shown.append((k, name, Camera.from_matrices(other.K, T, *size)))
    if not shown:
        raise InputError(f"{where}: other cameras have no picture and mask of the video's frames")
    numbers, seen_by, cameras = zip(*shown, strict=True)
    save_views(out / VIEWS, numbers, seen_by, cameras)
    notes = [f"{len(shown)} views held out, of cameras {', '.join(dict.fromkeys(seen_by))}"]
    if left_out:
        notes.append(f"left out, of another size of pictures: cameras {', '.join(left_out)}")
    return notes


def _extrinsic(camera: FixedCamera) -> np.ndarray:
    E = np.eye(4)
    E[:3, :3], E[:3, 3] = nearest_rotations(camera.R), camera.T
    return E


def _is_there(other: FixedCamera, number: int) -> bool:
    paths = other.frames.get(number), other.masks.get(number)
    return all(path is not None and path.is_file() for path in paths)


def _pair(other: FixedCamera, number: int, capture: Capture) -> tuple[np.ndarray, np.ndarray]:
    """Read a picture and its mask, 255 inside."""
    image = next(pictures((other.frames[number],), 3))
    mask = next(capture.read_masks((other.masks[number],)))
    require_sides(f"{other.masks[number]}:", mask, *image.shape[1::-1])
    return image, mask
