"""The format of a subject's folder: the name of each file, and the one writer of them.

::

    subject/
      video.mp4 | frames/000000.png ...   8-bit RGB; the frames win where both are there
      masks/000000.png | .npy             hard or soft: gva_mi.subject.masks
      normals/000000.png | .npy           optional; gva_mi.subject.normals
      normals.json                        optional: how the normals were made
      cameras.npz                         K (3,3) or (T,3,3); T_camera_world (4,4) or (T,4,4);
                                          width, height
      landmarks.npz                       optional; gva_mi.subject.landmarks
      poses.npz                           SMPL-X names, each (T, ...); betas (B,); stage
      poses_refined.npz                   optional: poses after stage 2
      splits.json                         optional: train and test frames; gva_mi.subject.splits
      views/                              optional: held-out other cameras, for evaluation
      truth/                              ground truth of synthetic subjects, for evaluation

Pictures, masks and normals of single frames may be missing. ``views``, ``truth`` and the parts of
``truth`` have the same files. :func:`gva_mi.subject.video.load_video` is the one reader.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from torch import Tensor

from gva_mi.body.pose import Pose, Shape, save_poses
from gva_mi.core.files import write_json
from gva_mi.splat import Camera
from gva_mi.subject.cameras import save_cameras
from gva_mi.subject.landmarks import Landmarks
from gva_mi.subject.pictures import write_image

VIDEO, FRAMES, MASKS, NORMALS = "video.mp4", "frames", "masks", "normals"
NORMALS_RECORD = "normals.json"
CAMERAS, LANDMARKS, SPLITS = "cameras.npz", "landmarks.npz", "splits.json"
POSES = "poses.npz"  # of stage 1
REFINED_POSES = "poses_refined.npz"  # of stage 2, where it was run
TRUTH, VIEWS = "truth", "views"


def frame_name(index: int, suffix: str = ".png") -> str:
    """Return the name of a frame's picture, mask or map of normals, such as 000012.png."""
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
    """Writes the files of a subject's folder; each appears when it is complete."""

    folder: Path

    @property
    def truth(self) -> SubjectWriter:
        """The writer of the ground truth."""
        return SubjectWriter(self.folder / TRUTH)

    def frame(self, index: int, image: np.ndarray) -> None:
        """Write a frame's picture (H, W, 3), 8-bit or in [0, 1]."""
        write_image(self.folder / FRAMES / frame_name(index), image)

    def mask(self, index: int, mask: np.ndarray) -> None:
        """Write a frame's mask (H, W), 8-bit or in [0, 1]."""
        write_image(self.folder / MASKS / frame_name(index), mask)

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
        """Write the poses of all frames, which ``stage`` made: 0 for the ground truth."""
        save_poses(self.folder / POSES, pose, shape, stage=stage, offsets=offsets)

    def landmarks(self, landmarks: Landmarks) -> None:
        """Write the landmarks of all frames."""
        landmarks.save(self.folder / LANDMARKS)

    def splits(self, record: Mapping[str, list[int]]) -> None:
        """Write which frames are for training and for tests, as ``Splits.to_json`` returns them."""
        write_json(self.folder / SPLITS, record)


class StoredPictures(Sequence[np.ndarray]):
    """Pictures in the numbered files of a folder, read one by one; none stays in memory.

    Attributes:
        count: how many there are; zero until it is set.
    """

    def __init__(self, folder: Path, suffix: str, read: Callable[[Path], np.ndarray]) -> None:
        self._folder, self._suffix, self._read, self.count = folder, suffix, read, 0

    def __len__(self) -> int:
        return self.count

    def __getitem__(self, index: int) -> np.ndarray:
        return self._read(self.path(index))

    def path(self, index: int) -> Path:
        """Return a picture's file."""
        return self._folder / frame_name(index, self._suffix)
