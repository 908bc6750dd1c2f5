"""``Estimator``: rules that recognise, read and interpret one estimator's files.

The table of all of them is in :mod:`.estimators`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from gva_mi.core.errors import InputError
from gva_mi.data.importers.estimator_files import SeenPerson
from gva_mi.data.importers.lens import centred, rescaled
from gva_mi.data.importers.spellings import OTHERS, is_numbers
from gva_mi.data.importers.target import TargetBody
from gva_mi.data.importers.tracks import Track, make_track


@dataclass(frozen=True)
class VideoInfo:
    """Facts about the video that a reader needs besides the file."""

    size: tuple[int, int]  # (W, H) of the video, pixels
    focal: float | None = None  # pixels, where the file says none
    body: TargetBody | None = None  # that poses are converted to


Arrays = Mapping[str, Any]  # (n, ...) each
Lens = Callable[[str, Arrays, VideoInfo], np.ndarray]  # where, arrays → K (3, 3) or (n, 3, 3)
# Our name: the file's name, or that name and a slice of joints. "betas?" may be missing.
Names = Mapping[str, "str | tuple[str, slice]"]


@dataclass(frozen=True)
class Estimator:
    """Rules that recognise one estimator's files, and the meaning of their arrays."""

    expects: str  # for messages
    recognises: Callable[[Any], bool]  # of what a file holds, or of a folder's path
    people: Callable[[str, Any], Iterable[SeenPerson]]
    lens: Lens = lambda where, arrays, info: arrays["K"]  # noqa: E731 (by default, the file's own)
    names: Names = field(default_factory=dict)  # none: the names of fields.py
    of_pelvis: bool = False  # its translation is the pelvis's position
    mean_hand: bool = False  # fingers are relative to the mean hand
    # Tracks of the camera in the world of its path; None where the file says no path.
    along_path: Callable[[Any, list[Track]], list[Track] | None] | None = None
    needs_video: bool = False  # places follow from an assumed lens: it is no motion on its own
    up: str | None = "-y"  # the axis of its people that is up; None: any
    # The number that it gives the first frame; None: that of the picture, by its name.
    first: int | None = 0

    def tracks(self, where: str, found: Any, info: VideoInfo) -> list[Track]:  # noqa: ANN401
        """Return the people in the camera's axes, one track each, frames ascending."""
        tracks = []
        for person in self.people(where, found):
            at = f"{where}: person {person.name}"
            K = np.asarray(self.lens(at, person.arrays, info), np.float64)
            given = self._named(person.arrays)
            track = make_track(at, person.name, person.frames, given, K, info.body, self.of_pelvis)
            mean = track.from_mean_hand or (self.mean_hand and track.has_hands)
            notes = (*track.notes, *self._left_out(person.arrays))
            tracks.append(replace(track, from_mean_hand=mean, notes=notes).sorted())
        return tracks

    def _named(self, arrays: Arrays) -> Arrays:
        """Return the arrays under the names of fields.py."""
        given = {} if self.names else dict(arrays)
        for ours, theirs in self.names.items():
            theirs, joints = theirs if isinstance(theirs, tuple) else (theirs, slice(None))
            key = theirs.removesuffix("?")
            if key in arrays or not theirs.endswith("?"):
                given[ours] = arrays[key] if joints == slice(None) else arrays[key][:, joints]
        return given

    def _left_out(self, arrays: Arrays) -> list[str]:
        """Return a note on arrays of numbers that :attr:`names` do not name."""
        named = {(x[0] if isinstance(x, tuple) else x).rstrip("?") for x in self.names.values()}
        rest = [k for k, x in arrays.items() if k not in OTHERS | named and is_numbers(x)]
        rest = rest if self.names else []
        return [f"not used of the source: {', '.join(sorted(rest))}"] if rest else []


def no_lens(where: str, arrays: Arrays, info: VideoInfo) -> np.ndarray:
    return np.eye(3)


def focal_of(rule: Callable[[VideoInfo], float]) -> Lens:
    """Return the centred lens that an estimator assumed; its focal length depends on the video."""
    return lambda where, arrays, info: centred(rule(info), info.size)


def lens_of_wham(where: str, arrays: Arrays, info: VideoInfo) -> np.ndarray:
    return centred(np.ravel(arrays.get("focal_length", np.hypot(*info.size)))[0], info.size)


def lens_of_hybrik(where: str, arrays: Arrays, info: VideoInfo) -> np.ndarray:
    """Return HybrIK's lens for each person's box, rescaled from its picture size to the video's."""
    box, sizes = arrays["bbox"], zip(arrays["width"], arrays["height"], strict=True)
    widths = 1000 / 256 * (box[:, 2] - box[:, 0])
    return np.stack([
        rescaled(where, centred(f, of), of, info.size)
        for f, of in zip(widths, sizes, strict=True)
    ])  # fmt: skip


def lens_of_romp(where: str, arrays: Arrays, info: VideoInfo) -> np.ndarray:
    """Return ROMP's lens: it pads pictures to a square, whose centre is rounded to whole pixels."""
    side = max(info.size)
    K = centred(443.4 / 512 * side, info.size)
    K[:2, 2] = [side / 2 - (side - length) // 2 for length in info.size]
    return K


def lens_by_name(where: str, arrays: Arrays, info: VideoInfo) -> np.ndarray:
    """Return the camera in a file, or one of the focal length that a user gives."""
    for name in ("K", "cam_K", "intrinsic", "intrinsics"):
        if arrays.get(name) is not None:
            K = np.asarray(arrays[name], np.float64)
            if K.shape[-2:] != (3, 3) or K.ndim > 3:
                raise InputError(f"{where}: '{name}' must be (3, 3) or (T, 3, 3), got {K.shape}")
            return K.reshape(-1, 3, 3)
    own = "stage" in arrays  # written here, where focal is a factor on the cameras' own
    names = ("focal_length",) if own else ("focal", "focal_length", "focal_l")
    focal = next((x for name in names if (x := arrays.get(name)) is not None), info.focal)
    if focal is None:
        raise InputError(f"{where}: says no camera (K, or focal); give --focal, in pixels")
    focal = np.ravel(np.asarray(focal, np.float64))
    if not focal.size or not (focal > 0).all():
        raise InputError(f"{where}: 'focal' must be one number above 0, or (T,); got {focal}")
    return np.stack([centred(f, info.size) for f in focal])
