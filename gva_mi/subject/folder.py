"""The format of a subject's folder: the name of each file, and the one writer of them.

======================  ======================================================= ====================
file in ``subject/``    content                                                 format
======================  ======================================================= ====================
``frames/000000.png``   8-bit RGB                                               ``pictures``
``video.mp4``           the same; used if there is no ``frames/``               ``video_file``
``masks/000000.png``    where the person is, hard or soft; or ``.npy``          ``masks``
``cameras.npz``         the camera of each frame                                ``cameras``
``poses.npz``           poses of stage 1                                        ``gva_mi.body.pose``
``poses_refined.npz``   optional: poses of stage 2                              ``gva_mi.body.pose``
``normals/000000.png``  optional: normals of the person; or ``.npy``            ``normals``
``normals.json``        optional: how the normals were made                     ``normals``
``landmarks.npz``       optional: named points of the person                    ``landmarks``
``overlay.png``         optional: where captions lie over the person            ``video``
``splits.json``         optional: train and test frames                         ``splits``
``prepare.json``        optional: what the folder was prepared from             ``fingerprint``
``synth.json``          optional: how a synthetic subject was made              ``fingerprint``
``views/``              optional: held-out views of other cameras               ``ground_truth``
``truth/``              optional: ground truth of a synthetic subject           ``ground_truth``
======================  ======================================================= ====================

Pictures, masks and normals of single frames may be missing. ``views``, ``truth`` and the parts of
``truth`` hold the same kinds of files.

:class:`SubjectWriter` writes them. :func:`gva_mi.subject.video.load_video` reads them, and
:func:`gva_mi.body.pose.read_pose_file` is its reader of poses. ``truth`` and ``views`` are read by
:mod:`gva_mi.subject.ground_truth` alone.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from torch import Tensor

from gva_mi.body.pose import Pose, Shape, save_poses
from gva_mi.core.files import write_json
from gva_mi.core.stamp import write_record
from gva_mi.splat import Camera
from gva_mi.subject.cameras import save_cameras
from gva_mi.subject.landmarks import Landmarks
from gva_mi.subject.pictures import read_image, write_image

FRAMES, VIDEO, MASKS, NORMALS = "frames", "video.mp4", "masks", "normals"
NORMALS_RECORD = "normals.json"
CAMERAS, LANDMARKS, SPLITS = "cameras.npz", "landmarks.npz", "splits.json"
POSES, REFINED_POSES = "poses.npz", "poses_refined.npz"
OVERLAY = "overlay.png"
PREPARED, SYNTH = "prepare.json", "synth.json"
TRUTH, VIEWS = "truth", "views"
VIEWS_RECORD = "views.json"  # in views/
# Files that a subject need not have. Once it had them, results without them would differ silently.
LISTED_PARTS = (
    LANDMARKS, SPLITS, NORMALS_RECORD, OVERLAY, VIEWS, TRUTH,
    *(f"{TRUTH}/{x}" for x in (MASKS, CAMERAS, POSES, "body.npz", "novel_pose", "novel_view")),
)  # fmt: skip


def frame_name(index: int, suffix: str = ".png") -> str:
    """Return the file name of a frame's picture, mask or normals, such as 000012.png."""
    return f"{index:06d}{suffix}"


def is_frame_name(path: Path) -> bool:
    """Whether a file is named like a frame."""
    return path.stem.isascii() and path.stem.isdecimal() and len(path.stem) == 6


def array_or_picture(folder: Path, index: int) -> Path:
    """Return the file of a frame's mask or normals: .npy if it exists, otherwise .png."""
    array = folder / frame_name(index, ".npy")
    return array if array.exists() else folder / frame_name(index)


@dataclass(frozen=True)
class SubjectWriter:
    """Writes the files of a subject's folder. Each file appears when it is complete."""

    folder: Path

    @property
    def truth(self) -> SubjectWriter:
        """The writer of the ground truth."""
        return SubjectWriter(self.folder / TRUTH)

    @property
    def views(self) -> SubjectWriter:
        """The writer of the held-out views."""
        return SubjectWriter(self.folder / VIEWS)

    def frame(self, index: int, image: np.ndarray) -> None:
        """Write a frame's picture (H, W, 3), 8-bit or in [0, 1]."""
        write_image(self.folder / FRAMES / frame_name(index), image)

    def mask(self, index: int, mask: np.ndarray) -> None:
        """Write a frame's mask (H, W), 8-bit or in [0, 1]."""
        write_image(self.folder / MASKS / frame_name(index), mask)

    def overlay(self, overlay: np.ndarray) -> None:
        """Write where captions and the like lie over the person in all frames, (H, W) bool."""
        write_image(self.folder / OVERLAY, np.where(overlay, 255, 0).astype(np.uint8))

    def remove_mask(self, index: int) -> None:
        """Delete a frame's mask, which makes the frame absent."""
        (self.folder / MASKS / frame_name(index)).unlink(missing_ok=True)

    def normals(self, index: int, normals: np.ndarray) -> None:
        """Write a frame's unit normals (H, W, 3), zero where unknown."""
        write_image(self.folder / NORMALS / frame_name(index), (normals + 1) / 2)

    def normals_record(self, convention: str, boxes: list[list[float]] | None = None) -> None:
        """Write how the normals were made, and the boxes (T, 4) of the frames that they show."""
        about = {"convention": convention} | ({} if boxes is None else {"boxes": boxes})
        write_json(self.folder / NORMALS_RECORD, about)

    def cameras(self, cameras: Sequence[Camera]) -> None:
        """Write the camera of each frame."""
        save_cameras(self.folder / CAMERAS, cameras)

    def poses(self, pose: Pose, shape: Shape, stage: int, offsets: Tensor | None = None) -> None:
        """Write ``poses.npz`` (:class:`gva_mi.body.pose.PoseFile`).

        ``stage`` is 1, or 0 for ground truth.
        """
        save_poses(self.folder / POSES, pose, shape, stage=stage, offsets=offsets)

    def refined_poses(self, pose: Pose, shape: Shape, offsets: Tensor | None) -> None:
        """Write ``poses_refined.npz``, the poses of stage 2."""
        save_poses(self.folder / REFINED_POSES, pose, shape, stage=2, offsets=offsets)

    def landmarks(self, landmarks: Landmarks) -> None:
        """Write the landmarks of all frames."""
        landmarks.save(self.folder / LANDMARKS)

    def splits(self, record: Mapping[str, list[int]]) -> None:
        """Write the train and test frames, as ``Splits.to_json`` returns them."""
        write_json(self.folder / SPLITS, record)

    def record(self, name: str, about: Mapping[str, Any]) -> None:
        """Write ``prepare.json`` or ``synth.json`` last; its ``files`` lists the folder's parts.

        :func:`gva_mi.subject.fingerprint.require_listed` looks for them.
        """
        parts = [part for part in LISTED_PARTS if (self.folder / part).exists()]
        write_record(self.folder / name, {**about, "files": parts})

    def views_record(self, frames: Sequence[int], names: Sequence[str]) -> None:
        """Write the video's frame, and the camera's name, of each picture in ``views``."""
        record = {"frames": list(frames), "cameras": list(names)}
        write_json(self.folder / VIEWS / VIEWS_RECORD, record)


@dataclass(frozen=True)
class StoredPictures(Sequence[np.ndarray]):
    """The frames in a folder as a sequence that reads each file when it is used."""

    folder: Path
    count: int

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> np.ndarray:
        return read_image(self.folder / frame_name(index), 3)
