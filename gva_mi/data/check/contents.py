"""``Contents``: all that can be read of a subject's folder, whatever else is wrong with it.

Steps open a folder by :func:`gva_mi.data.video.load_video`, which stops at the first thing that
they cannot use. Here everything is read for itself, and what cannot be read is a finding.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np

from gva_mi.core.console import Progress
from gva_mi.core.errors import InputError
from gva_mi.core.files import read_array, read_arrays
from gva_mi.data.check.findings import Finding
from gva_mi.data.film import Film
from gva_mi.data.masks import read_mask
from gva_mi.data.pictures import read_image
from gva_mi.data.video import POSES, is_frame

T = TypeVar("T")
SMALL = 192  # px, longer side of the masks that are compared: a person of 1.8 m has 1 px a cm


@dataclass(frozen=True)
class MaskSeen:
    """A mask, as far as it is needed."""

    size: tuple[int, int]  # (W, H)
    small: np.ndarray  # (h, w) bool, at most SMALL pixels long
    share: float  # of its pixels that are inside
    border: float  # of the picture's border that is inside
    largest: int  # the largest stored value, of 255


@dataclass
class Contents:
    """What a folder holds."""

    folder: Path
    pictures: dict[int, tuple[int, int]] = field(default_factory=dict)  # (W, H) of each
    masks: dict[int, MaskSeen] = field(default_factory=dict)
    cameras: dict[str, np.ndarray] | None = None  # arrays of cameras.npz
    poses: dict[str, np.ndarray] | None = None  # arrays of the file of poses
    poses_file: Path = Path(POSES)
    findings: list[Finding] = field(default_factory=list)
    film: Film | tuple[()] = ()  # where the pictures come as one

    @property
    def count(self) -> int:
        """Frames of the video, with those between that are missing."""
        return max(self.pictures, default=-1) + 1

    def picture(self, index: int) -> np.ndarray:
        """A frame, (H, W, 3) 8-bit."""
        if len(self.film):
            return self.film[index]
        return read_image(self.folder / "frames" / f"{index:06d}.png", 3)


def read_contents(folder: Path, poses: Path | None, progress: Progress | None) -> Contents:
    """Read a folder.

    Args:
        folder: of a subject.
        poses: another file of poses than the folder's own.
        progress: told how many pictures are read.

    Raises:
        InputError: there is no such folder, or nothing of a subject in it.
    """
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; expected a subject's")
    parts = ("video.mp4", "frames", "masks", "cameras.npz", POSES)
    if not any((folder / part).exists() for part in parts):
        raise InputError(f"{folder}: no subject's folder; expected some of {', '.join(parts)}")
    contents = Contents(folder, poses_file=poses or folder / POSES)
    _read_pictures(contents)
    _read_masks(contents, progress)
    camera_keys = "K, T_camera_world, width, height (.npz)"
    read = lambda path, expected: attempt(contents, lambda: read_arrays(path, expected))
    contents.cameras = read(folder / "cameras.npz", camera_keys)
    contents.poses = read(contents.poses_file, "poses under SMPL-X's names (.npz)")
    return contents


def attempt(contents: Contents, read: Callable[[], T]) -> T | None:
    """What is read; None, and a finding, where it cannot be."""
    try:
        return read()
    except InputError as error:
        contents.findings.append(
            Finding(
                "error", "unreadable", str(error), "missing, cut short, or of another form",
                "write it again in the form that README tells",
            )
        )  # fmt: skip
        return None


def _read_pictures(contents: Contents) -> None:
    folder, found = contents.folder, contents.findings
    files = sorted((folder / "frames").glob("*.png"))
    misnamed = [p.name for p in files if not is_frame(p)]
    if misnamed:
        found.append(
            Finding(
                "error", "frames named otherwise", f"{len(misnamed)}, such as {misnamed[0]}",
                "numbered by another program", "name them 000000.png, 000001.png, ...",
            )
        )  # fmt: skip
    for path in files:
        if path.name not in misnamed:
            image = attempt(contents, lambda path=path: read_image(path, 3))
            if image is not None:
                contents.pictures[int(path.stem)] = image.shape[1::-1]
    if not files:
        film = folder / "video.mp4"
        if film.exists():
            contents.film = attempt(contents, lambda: Film(film)) or ()
            contents.pictures = dict(enumerate(getattr(contents.film, "sizes", ())))
        else:
            found.append(
                Finding(
                    "error", "no pictures", "0 frames", "neither frames/ nor video.mp4 is there",
                    "put video.mp4 or frames/000000.png ... into the folder",
                )
            )  # fmt: skip


def _read_masks(contents: Contents, progress: Progress | None) -> None:
    for done, k in enumerate(sorted(contents.pictures)):
        if progress is not None:
            progress(done + 1, len(contents.pictures))
        mask = attempt(contents, lambda k=k: read_mask(contents.folder / "masks", k))
        if mask is not None and mask.size:
            contents.masks[k] = _seen(mask, _largest(contents.folder / "masks", k))


def _largest(folder: Path, index: int) -> int:
    """The largest value of a stored mask, 255 for one of floating point or Booleans."""
    path = folder / f"{index:06d}.npy"
    stored = read_array(path) if path.exists() else read_image(path.with_suffix(".png"), 1)
    return int(stored.max(initial=0)) if stored.dtype == np.uint8 else 255


def _seen(mask: np.ndarray, largest: int) -> MaskSeen:
    height, width = mask.shape
    inside = mask > 0.5
    border = np.concatenate([inside[0], inside[-1], inside[:, 0], inside[:, -1]])
    small = shrunk(inside.astype(np.float32), *small_size(width, height)) > 0.5
    return MaskSeen((width, height), small, float(inside.mean()), float(border.mean()), largest)


def small_size(width: int, height: int) -> tuple[int, int]:
    """(w, h) of a picture at which it is compared."""
    scale = min(1.0, SMALL / max(width, height))
    return max(1, round(width * scale)), max(1, round(height * scale))


def shrunk(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """An image (H, W) float32, each of its pixels the mean of those that it covers."""
    from PIL import Image

    return np.asarray(Image.fromarray(image).resize((width, height), Image.Resampling.BOX))
