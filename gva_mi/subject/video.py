"""``Video`` and ``Frame``, the input of every step; :func:`load_video` reads a subject's folder.

:mod:`gva_mi.subject.folder` lists the files. Pictures, masks and normals of single frames may be
missing. A frame without a picture, or with a missing or empty mask, is *absent*: it belongs to no
split, and no step changes its pose.

All files are checked when the folder is opened, so that no step stops half-way at a bad file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from torch import Tensor

from gva_mi.body.pose import Pose, Shape, read_pose_file
from gva_mi.core.errors import InputError
from gva_mi.core.files import once_a_file
from gva_mi.core.tasks import on_all_cores
from gva_mi.splat import Camera
from gva_mi.subject.backdrop import premultiplied
from gva_mi.subject.cameras import load_cameras
from gva_mi.subject.crop import block_means
from gva_mi.subject.fingerprint import prepared_from, require_listed
from gva_mi.subject.folder import (
    CAMERAS,
    FRAMES,
    LANDMARKS,
    MASKS,
    OVERLAY,
    POSES,
    TRUTH,
    VIDEO,
    array_or_picture,
    frame_name,
    is_frame_name,
)
from gva_mi.subject.landmarks import Landmarks
from gva_mi.subject.masks import INSIDE_ABOVE, read_mask
from gva_mi.subject.normals import Convention, NormalMaps, Part
from gva_mi.subject.pictures import read_image, require_sides, size_of_whole
from gva_mi.subject.splits import Splits, load_splits
from gva_mi.subject.video_file import VideoFile


@dataclass(frozen=True)
class Frame:
    """One picture of the person with its mask, normals, camera and pose."""

    index: int
    image: np.ndarray  # (H, W, 3) float32 in [0, 1]
    mask: np.ndarray  # (H, W) float32 in [0, 1]
    normals: np.ndarray | None  # (H, W, 3) float32, unit, camera space; zero outside the mask
    camera: Camera
    pose: Pose  # of one frame
    overlay: np.ndarray | None = None  # (H, W) bool: pixels that do not show what is behind them

    def on_background(self, color: float | np.ndarray = 1.0) -> np.ndarray:
        """Return the person on a plain background, (H, W, 3); ``color`` is a grey or (3,)."""
        return self.premultiplied + color * (1 - self.mask[..., None])

    @cached_property
    def premultiplied(self) -> np.ndarray:
        """The person's colour times the mask, (H, W, 3), with the background's colour removed."""
        return premultiplied(self.image, self.mask)


@dataclass(frozen=True)
class FrameWithoutPicture:
    """A frame whose picture is not read, because reading it takes longest."""

    index: int
    mask: np.ndarray  # (H, W) float32 in [0, 1]
    normals: Callable[[Part], np.ndarray | None]  # reads a part of the frame's normals
    camera: Camera
    pose: Pose  # of one frame


@dataclass(frozen=True)
class Video:
    """A subject's video: pictures of one camera with masks, cameras and poses."""

    folder: Path
    cameras: list[Camera]
    pose: Pose
    shape: Shape
    splits: Splits
    # Lazy pictures of video.mp4; empty: frames/ are read on demand.
    _images: Sequence[np.ndarray] = field(repr=False)
    normals: NormalMaps | None = None  # None: no frame has normals
    absent: Mapping[int, str] = field(default_factory=dict)  # the reason for each unusable frame
    stage: int = 1  # source of the poses, as in gva_mi.body.pose.PoseFile
    offsets: Tensor | None = None  # (V, 3) metres, displacements of the rest surface
    landmarks: Landmarks | None = None  # of all frames
    # (H, W) bool: where captions, logos or furniture lie over the person in all frames.
    overlay: np.ndarray | None = None
    kind: str | None = None  # source of poses.npz, as in prepare.json; None: unknown
    fps: float | None = None  # frames a second, as in prepare.json; None: unknown
    shrink: int = 1  # downscaling factor: a pixel is the mean of shrink × shrink file pixels

    def __len__(self) -> int:
        return len(self.cameras)

    def __getitem__(self, index: int) -> Frame:
        """Return one frame; an absent frame is white, with an empty mask."""
        camera, pose = self.cameras[index], self.pose[index]
        if index in self.absent:
            size = (camera.height, camera.width)
            white, nobody = np.ones((*size, 3), "f4"), np.zeros(size, "f4")
            return Frame(index, white, nobody, None, camera, pose, self.overlay)
        path = self.folder / FRAMES / frame_name(index)
        image = self._images[index] if self._images else read_image(path, 3)
        image = block_means(image.astype(np.float32) / 255, self.shrink)
        mask = self._mask(index)
        normals = self._normals_of(index, mask)((slice(None), slice(None)))
        return Frame(index, image, mask, normals, camera, pose, self.overlay)

    def frames(self, indices: Iterable[int] | None = None) -> Iterator[Frame]:
        """Yield the frames of the given indices, or all frames; files are read ahead."""
        indices = range(len(self)) if indices is None else indices
        read = map if self._images else on_all_cores
        return read(self.__getitem__, indices)

    def outlines(self, indices: Iterable[int]) -> Iterator[FrameWithoutPicture]:
        """Yield frames without their pictures; the indices must not contain absent frames."""
        for k in indices:
            mask = self._mask(k)
            yield FrameWithoutPicture(
                k, mask, self._normals_of(k, mask), self.cameras[k], self.pose[k]
            )

    def _mask(self, index: int) -> np.ndarray:
        return block_means(read_mask(self.folder / MASKS, index), self.shrink)

    def _normals_of(self, index: int, mask: np.ndarray) -> Callable[[Part], np.ndarray | None]:
        """Return a function that reads a part of a frame's normals, zero outside its mask."""

        def normals(part: Part) -> np.ndarray | None:
            found = self.normals.read(index, self.cameras[index], part) if self.normals else None
            return None if found is None else found * (mask[part] > 0.5)[..., None]

        return normals

    def downscaled(self, factor: int) -> Video:
        """Return the video with pictures that are ``factor`` times smaller, without normals.

        A pixel is the mean of a square; incomplete squares at the right and bottom are cropped.
        """
        if factor == 1:
            return self
        small = lambda c: c.cropped(0, 0, c.width // factor * factor, c.height // factor * factor)
        cameras = [small(c).resized(c.width // factor, c.height // factor) for c in self.cameras]
        landmarks = self.landmarks and self.landmarks.downscaled(factor)
        smaller = replace(
            self, cameras=cameras, normals=None, landmarks=landmarks, shrink=factor * self.shrink
        )
        if self.overlay is None:
            return smaller
        overlay = block_means(self.overlay.astype(np.float32), factor) > 0
        return replace(smaller, overlay=overlay)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the pictures, pixels."""
        return self.cameras[0].width, self.cameras[0].height

    def offsets_of(self, vertices: int) -> Tensor | None:
        """Return the rest surface's displacement for a body of ``vertices``; None without one."""
        if self.offsets is not None and len(self.offsets) != vertices:
            raise InputError(
                f"{self.folder}: its poses have 'offsets' {tuple(self.offsets.shape)}, expected "
                f"{(vertices, 3)}"
            )
        return self.offsets

    def require_train_frames(self) -> None:
        """Raise an InputError if there is no train frame."""
        if not self.splits.train:
            k, reason = next(iter(self.absent.items()))
            raise InputError(f"{self.folder}: no train frame can be used; frame {k}: {reason}")

    @property
    def truth(self) -> Path | None:
        """The folder with the ground truth of a synthetic subject."""
        folder = self.folder / TRUTH
        return folder if folder.is_dir() else None

    def true_mask(self, index: int) -> np.ndarray | None:
        """Read the ground-truth mask (H, W) of a synthetic subject; for evaluation only."""
        path = self.truth / MASKS / frame_name(index) if self.truth else None
        if path is None or not path.exists():
            return None
        mask = block_means(read_image(path, 1).astype(np.float32) / 255, self.shrink)
        require_sides(f"{path}:", mask, *self.size)
        return mask

    def with_true_mask(self, frame: Frame) -> Frame:
        """Return a frame with its ground-truth mask, if the ground truth is known."""
        mask = self.true_mask(frame.index)
        return frame if mask is None else replace(frame, mask=mask)


def load_video(
    folder: Path, poses: Path | None = None, normals: Convention | Literal["none"] | None = None
) -> Video:
    """Read a subject's folder and validate all of its files.

    Args:
        folder: in the format of :mod:`gva_mi.subject.folder`.
        poses: pose file, for example the refined poses; None: ``folder/poses.npz``.
        normals: convention of the normals, overrides ``normals.json``; ``"none"`` ignores normals.

    Raises:
        InputError: a file cannot be used; the message names the first such file.
    """
    return read_video(folder, lambda what, frame, read, *given: read(*given), poses, normals)


def read_video(
    folder: Path,
    attempt: Callable[..., Any],
    poses: Path | None = None,
    normals: Convention | Literal["none"] | None = None,
) -> Video | None:
    """Read a subject's folder as :func:`load_video` does; call ``attempt`` for each file.

    ``attempt(what, frame, read, *given)`` calls ``read(*given)``; it re-raises an error, or records
    it and returns None (:meth:`gva_mi.subject.problems.Faults.attempt`).

    Returns:
        The video; None if its pictures, cameras or poses cannot be used.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(
            f"{folder}: {'is a file' if folder.exists() else 'no such folder'}; expected a subject "
            "with video.mp4 or frames/, masks/, cameras.npz and poses.npz"
        )
    images, sizes = _open_pictures(folder, attempt)
    count = max(sizes, default=-1) + 1 or None
    cameras = attempt("cameras", None, load_cameras, folder / CAMERAS, count)
    poses = poses or folder / POSES
    found = attempt("poses", None, read_pose_file, poses, count)
    if count is None:
        return None
    maps = None
    if normals != "none":
        maps = attempt("normals", None, NormalMaps.open, folder, count, normals)
    absent = {k: "it has no picture" for k in range(count) if k not in sizes}
    for k, size in sizes.items():
        camera = None if cameras is None else cameras[k]
        expected = size if camera is None else (camera.width, camera.height)
        attempt("pictures", k, _require_size, folder, k, size, expected)
        mask = array_or_picture(folder / MASKS, k)
        reason = attempt("masks", k, _why_absent, mask, *expected)
        if reason != "":
            absent[k] = reason or "its mask cannot be used"
        elif maps is not None and camera is not None:
            attempt("normals", k, maps.check, k, camera)
    if len(absent) == count:
        attempt("frames", None, _refuse, f"{folder}: no frame can be used; frame 0: {absent[0]}")
    attempt("files", None, require_listed, folder, count)
    splits = attempt("splits", None, load_splits, folder, count) or Splits.every(count)
    kind = fps = None
    if poses == folder / POSES:
        kind, fps = attempt("prepare.json", None, prepared_from, folder) or (None, None)
    landmarks = attempt("landmarks", None, _open_landmarks, folder, count)
    overlay = attempt("overlay", None, _open_overlay, folder, sizes)
    if cameras is None or found is None:
        return None
    absent = dict(sorted(absent.items()))
    return Video(
        folder, cameras, found.pose, found.shape, splits.without(absent), images, maps, absent,
        found.stage, found.offsets, landmarks, overlay, kind, fps,
    )  # fmt: skip


def _open_pictures(
    folder: Path, attempt: Callable[..., Any]
) -> tuple[VideoFile | list[np.ndarray], dict[int, tuple[int, int]]]:
    """Open ``video.mp4`` ([] for ``frames/``); also return the size (W, H) of each picture."""
    files = sorted((folder / FRAMES).glob("[!.]*.png"))
    if not files:
        video_file = attempt("pictures", None, _open_video_file, folder)
        return ([], {}) if video_file is None else (video_file, dict(enumerate(video_file.sizes)))
    for path in files:
        if not is_frame_name(path):
            attempt("pictures", None, _refuse, f"{path}: frames are numbered, such as 000000.png")
    frames = {int(path.stem): path for path in files if is_frame_name(path)}
    size_of = lambda k: attempt("pictures", k, size_of_whole, frames[k])
    sizes = dict(zip(frames, on_all_cores(size_of, frames), strict=True))
    return [], {k: size for k, size in sizes.items() if size is not None}


def _open_video_file(folder: Path) -> VideoFile:
    if not (folder / VIDEO).exists():
        raise InputError(f"{folder}: no pictures; expected frames/000000.png ... or video.mp4")
    return VideoFile(folder / VIDEO)


def _require_size(
    folder: Path, index: int, size: tuple[int, int], expected: tuple[int, int]
) -> None:
    if size != expected:
        raise InputError(
            f"{folder}: frame {index} is {size[0]}x{size[1]}, "
            f"but {CAMERAS} says {expected[0]}x{expected[1]}"
        )


def _refuse(reason: str) -> None:
    raise InputError(reason)


@once_a_file
def _why_absent(file: Path, width: int, height: int) -> str:
    """Return the reason why a frame is absent, judged by its mask; empty if it can be used."""
    folder, index = file.parent, int(file.stem)
    mask = read_mask(folder, index)
    if mask is None:
        return "it has no mask"
    require_sides(f"{folder}: mask of frame {index}", mask, width, height)
    if not mask.any():
        return "its mask is empty"
    faint = f"no mask pixel exceeds 0.5 (maximum {mask.max():.2g})"
    return "" if (mask > 0.5).any() else faint


def _open_landmarks(folder: Path, count: int) -> Landmarks | None:
    """Read the landmarks of a subject of ``count`` frames; None if it has none."""
    path = folder / LANDMARKS
    if not path.is_file():
        return None
    landmarks = Landmarks.load(path)
    if len(landmarks) != count:
        raise InputError(f"{path}: holds {len(landmarks)} frames, but the video has {count}")
    return landmarks


def _open_overlay(folder: Path, sizes: Mapping[int, tuple[int, int]]) -> np.ndarray | None:
    """Read where captions lie over the person (H, W) bool; None if the subject has no such file."""
    path = folder / OVERLAY
    if not path.is_file():
        return None
    overlay = read_image(path, 1) > INSIDE_ABOVE
    require_sides(f"{path}:", overlay, *next(iter(sizes.values()), overlay.shape[::-1]))
    return overlay
