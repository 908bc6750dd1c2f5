"""The pictures of a video, or of a folder, at an even rate, as input of the networks.

* A video whose rate varies, as phones' do, is sampled at even times: the nearest picture of each.
* A video of an even rate keeps every picture, or every n-th one if fewer are wanted.
* A folder's pictures are ordered by the last number in their names; their rate is given.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gva_mi.core.errors import InputError
from gva_mi.subject.footage import files_of, varying
from gva_mi.subject.lens import recorded_35mm
from gva_mi.subject.pictures import opened, read_image
from gva_mi.subject.video_file import VideoFile

# Pictures a second: the most that are used, unless more are asked for, and the rate of a folder;
# chosen: what phones record.
DEFAULT_FPS = 30.0


@dataclass(frozen=True)
class EvenPictures:
    """The pictures of a video at an even rate."""

    pictures: Sequence[np.ndarray]  # T of (H, W, 3) 8-bit sRGB, upright, read one by one
    fps: float  # pictures a second
    focal35: float | None  # recorded focal length, mm of 35 mm film; None: not recorded
    notes: tuple[str, ...]  # what was done to the video, sentences for its user
    numbers: tuple[int, ...]  # T: which of the video's pictures each is
    total: int  # pictures of the video
    scale: float  # pixels of these pictures per pixel of the video, at most 1


def even_pictures(
    path: Path,
    fps: float | None = None,
    side: int | None = None,
    end: float | None = None,
) -> EvenPictures:
    """Open a video, or a folder of pictures.

    Args:
        path: the video or the folder.
        fps: wanted pictures a second; a video of an even rate gives the nearest rate that every
            n-th picture has. None: :data:`DEFAULT_FPS`, or fewer if there are fewer. For a folder,
            the rate of its pictures.
        side: largest shorter side of the pictures, pixels; None: as they are.
        end: seconds; later pictures are left out; None: the end of the video.
    """
    path = Path(path)
    files, notes = files_of(path), []
    if files is not None:
        source, sizes = files, [_upright_size(file) for file in files]
        times = np.arange(len(files)) / (fps or DEFAULT_FPS)
        if fps is None:
            notes.append(f"a folder records no times: taken as {DEFAULT_FPS:g} pictures a second")
    else:
        source = VideoFile(path, end=end)
        sizes, times, notes = source.sizes, source.times, list(source.notes)
        if times is None:
            times = np.arange(len(source)) / (fps or DEFAULT_FPS)
            taken = f"{fps or DEFAULT_FPS:g} pictures a second"
            notes.append(f"the video records no times: taken as {taken}")
    if len(set(sizes)) > 1:
        first, other = sizes[0], next(size for size in sizes if size != sizes[0])
        raise InputError(
            f"{path}: its pictures have several sizes, {first[0]}x{first[1]} and "
            f"{other[0]}x{other[1]}; expected one size"
        )
    chosen, rate, more = _evenly(times, fps or DEFAULT_FPS, end)
    pictures = _Chosen(source, chosen, side)
    scale = min(1.0, side / min(sizes[0])) if side else 1.0
    recorded, numbers = recorded_35mm(path), tuple(chosen.tolist())
    return EvenPictures(pictures, rate, recorded, (*notes, *more), numbers, len(sizes), scale)


def _evenly(
    times: np.ndarray, fps: float, end: float | None
) -> tuple[np.ndarray, float, list[str]]:
    """Choose pictures at even times from those at ``times`` (n,), seconds, ascending.

    Returns:
        the numbers of the chosen pictures (T,), their rate, and notes.
    """
    within = np.flatnonzero(times <= (np.inf if end is None else end) + 1e-6)
    if len(within) < 2:
        return within, min(fps, DEFAULT_FPS), []
    times = times[within]
    steps = np.diff(times)
    usual = float(np.median(steps))
    if usual <= 0:
        return within, min(fps, DEFAULT_FPS), []
    rate_of_video = (len(times) - 1) / float(times[-1] - times[0])
    if (varies := varying(steps, 0.001)) is None:
        every = max(1, round(rate_of_video / fps))
        notes = [f"of {rate_of_video:.3g} pictures a second one in {every} is used"] * (every > 1)
        return within[::every], rate_of_video / every, notes
    rate = min(fps, 1 / usual)
    wanted = np.arange(times[0], times[-1] + 0.5 / rate, 1 / rate)
    middle = (times[1:] + times[:-1]) / 2
    note = f"{varies}; sampled at even {rate:.3g} a second"
    return within[np.searchsorted(middle, wanted)], rate, [note]


def _upright_size(path: Path) -> tuple[int, int]:
    """Return the size (W, H) of a picture after its metadata's rotation, without decoding it."""
    with opened(path) as image:
        on_its_side = image.getexif().get(0x0112, 1) >= 5
        return image.size[::-1] if on_its_side else image.size


class _Chosen(Sequence[np.ndarray]):
    """Some pictures of a video or of files, scaled down."""

    def __init__(
        self, source: Sequence[np.ndarray | Path], chosen: np.ndarray, side: int | None
    ) -> None:
        self._source, self._chosen, self._side = source, chosen.tolist(), side

    def __len__(self) -> int:
        return len(self._chosen)

    def __getitem__(self, index: int) -> np.ndarray:
        from PIL import Image

        found = self._source[self._chosen[index]]
        image = read_image(found, 3) if isinstance(found, Path) else found
        height, width = image.shape[:2]
        if self._side is None or min(height, width) <= self._side:
            return image
        scale = self._side / min(height, width)
        size = max(1, round(width * scale)), max(1, round(height * scale))
        return np.asarray(Image.fromarray(image).resize(size, Image.Resampling.BOX))
