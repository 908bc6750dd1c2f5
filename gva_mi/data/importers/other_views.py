"""A data set's other cameras, as views of the subject that are held out: :mod:`gva_mi.data.views`.

With E = [R T] of a camera in the data set's world, and the video's camera turned upright by W,

    E_subject = E E_video⁻¹ W,

so that the person whom the video's poses place is seen by the others, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import roma
import torch

from gva_mi.data.importers.footage import masks, pictures
from gva_mi.data.importers.lenses import pinhole
from gva_mi.data.importers.recordings import OtherCamera, Recording
from gva_mi.data.pictures import write_image
from gva_mi.data.video import spread
from gva_mi.data.views import VIEWS, save_views
from gva_mi.errors import InputError, expecting
from gva_mi.splat import Camera

ALL = "all"  # in the place of names


def known_names(where: str, recording: Recording, names: Sequence[str]) -> list[str]:
    """The names of the other cameras that are meant.

    Args:
        where: the data set, for errors.
        recording: with its other cameras.
        names: of those wanted, or "all"; none: none.

    Raises:
        InputError: there is no such camera.
    """
    there = recording.others
    names = list(there) if list(names) == [ALL] and there else list(names)
    for name in names:
        if name not in there:
            some = ", ".join(list(there)[:30]) or "none"
            raise InputError(f"{where}: has no other camera '{name}' to hold out; it has {some}")
    return names


def write_views(
    out: Path,
    where: str,
    recording: Recording,
    names: Sequence[str],
    frames: Sequence[int],
    each: int,
    upright: np.ndarray,
) -> list[str]:
    """Write ``views/`` of a subject's folder.

    Args:
        out: the subject's folder.
        where: the data set, for errors.
        recording: with its other cameras.
        names: of those wanted, as :func:`known_names` returns them.
        frames: of the video, that may be seen.
        each: at most so many of them by each camera, evenly spaced.
        upright: (4, 4) W.

    Returns:
        What to say about them.

    Raises:
        InputError: none has a picture and a mask of such a frame.
    """
    T_video = np.linalg.inv(extrinsic(recording.own.R, recording.own.T)) @ upright
    cameras, shown, seen_by, left_out = [], [], [], []
    for name in names:
        at = f"{where}: camera {name}"
        with expecting(at, "K, R, T and its pictures, as the first camera has them"):
            other = recording.others[name]()
            T = extrinsic(other.R, other.T) @ T_video
            Camera.from_matrices(other.K, T, 1, 1)  # which refuses what no camera has
        places = {k: recording.numbers[k] for k in frames}
        both = [k for k in frames if _is_there(other, places[k])]
        for k in spread(both, each):
            image, mask = _pair(other, places[k], recording)
            size = image.shape[1::-1]
            if cameras and size != (cameras[0].width, cameras[0].height):
                left_out.append(name)
                break
            straight = pinhole(at, other.K, other.distortion, size)
            file = f"{len(shown):06d}.png"
            write_image(out / VIEWS / "frames" / file, straight(image))
            write_image(out / VIEWS / "masks" / file, straight(mask))
            cameras.append(Camera.from_matrices(other.K, T, *size))
            shown.append(k)
            seen_by.append(name)
    if not shown:
        raise InputError(f"{where}: other cameras have no picture and mask of the video's frames")
    save_views(out / VIEWS, shown, seen_by, cameras)
    notes = [f"{len(shown)} views held out, of cameras {', '.join(dict.fromkeys(seen_by))}"]
    if left_out:
        notes.append(f"left out, of another size of pictures: cameras {', '.join(left_out)}")
    return notes


def extrinsic(R: np.ndarray, T: np.ndarray) -> np.ndarray:
    """(4, 4) of R (3, 3), made a rotation where digits were lost, and T (3,)."""
    E = np.eye(4)
    E[:3, :3] = roma.special_procrustes(torch.from_numpy(np.array(R, np.float64))).numpy()
    E[:3, 3] = np.ravel(T)
    return E


def _is_there(other: OtherCamera, number: int) -> bool:
    """Whether a camera has a picture and a mask of that number."""
    paths = other.frames.get(number), other.masks.get(number)
    return all(path is not None and path.is_file() for path in paths)


def _pair(other: OtherCamera, number: int, recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """A picture and its mask, 255 inside."""
    image = next(pictures((other.frames[number],), 3))
    mask = next(masks((other.masks[number],)))
    if mask.shape != image.shape[:2]:
        raise InputError(
            f"{other.masks[number]}: is {mask.shape[1]}x{mask.shape[0]}, expected "
            f"{image.shape[1]}x{image.shape[0]}"
        )
    return image, (mask > 0) * np.uint8(255) if recording.labels else mask
