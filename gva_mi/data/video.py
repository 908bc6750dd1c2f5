"""``Video`` and ``Frame``: what every step reads, and the folder they are read from.

::

    subject/
      video.mp4 | frames/000000.png ...   8-bit RGB; the frames win where both are there
      masks/000000.png                    8-bit grey, 255 inside (soft allowed)
      normals/000000.png | .npy           optional; camera space, OpenCV axes, (n + 1) / 2 in a PNG
      cameras.npz                         K (3,3) or (T,3,3); T_camera_world (4,4) or (T,4,4);
                                          width, height
      poses.npz                           SMPL-X names, each (T, ...); betas (B,); stage
      splits.json                         optional: {"train": [...], "test": [...]} frame numbers
      truth/                              synthetic subjects only; read by nothing but evaluation

Everything is checked when it is opened, once, so that a step never stops half-way for a bad file.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from gva_mi.body.pose import Pose, Shape, load_poses
from gva_mi.data.pictures import read_image, read_movie, read_normals
from gva_mi.errors import InputError
from gva_mi.files import read_arrays, require_keys, write_arrays
from gva_mi.splat import Camera

TEST_EVERY = 8  # without splits.json, every 8th frame is a test frame


@dataclass(frozen=True)
class Frame:
    """One picture of the person and what is known about it."""

    index: int
    image: np.ndarray  # (H, W, 3) float32 in [0, 1]
    mask: np.ndarray  # (H, W) float32 in [0, 1]
    normals: np.ndarray | None  # (H, W, 3) float32, unit, camera space; zero outside the mask
    camera: Camera
    pose: Pose  # of one frame

    def on_background(self, color: float = 1.0) -> np.ndarray:
        """The person alone on a plain background, (H, W, 3)."""
        mask = self.mask[..., None]
        return self.image * mask + color * (1 - mask)


@dataclass(frozen=True)
class Splits:
    """Which frames are trained on, and which are never seen in training."""

    train: list[int]
    test: list[int]

    @staticmethod
    def every(step: int, frames: int) -> Splits:
        """Every ``step``-th frame is a test frame."""
        test = list(range(step // 2, frames, step))
        return Splits([k for k in range(frames) if k not in set(test)], test)


@dataclass(frozen=True)
class Video:
    """A monocular video with its masks, cameras and poses."""

    folder: Path
    cameras: list[Camera]
    pose: Pose
    shape: Shape
    splits: Splits
    _images: Sequence[np.ndarray] = field(
        repr=False
    )  # decoded pictures, or [] to read frames/ one by one
    has_normals: bool = True

    def __len__(self) -> int:
        return len(self.cameras)

    def __getitem__(self, index: int) -> Frame:
        camera = self.cameras[index]
        image = (
            self._images[index]
            if self._images
            else read_image(_picture(self.folder / "frames", index), 3)
        )
        mask = read_image(_picture(self.folder / "masks", index), 1)
        normals = read_normals(self.folder / "normals", index) if self.has_normals else None
        if normals is not None:
            normals = normals * (mask > 127)[..., None]
        picture = image.astype(np.float32) / 255
        return Frame(
            index, picture, mask.astype(np.float32) / 255, normals, camera, self.pose[index]
        )

    def frames(self, indices: Iterable[int] | None = None) -> Iterator[Frame]:
        """The frames of some indices, or all of them, one by one."""
        return (self[k] for k in (range(len(self)) if indices is None else indices))

    @property
    def size(self) -> tuple[int, int]:
        """(W, H) in pixels."""
        return self.cameras[0].width, self.cameras[0].height

    @property
    def truth(self) -> Path | None:
        """The folder with the truth of a synthetic subject."""
        folder = self.folder / "truth"
        return folder if folder.is_dir() else None


def load_video(folder: Path, poses: Path | None = None) -> Video:
    """Open a subject's folder and check everything in it.

    Args:
        folder: in the format above.
        poses: another file of poses than ``folder/poses.npz``, such as the refined ones.

    Raises:
        InputError: the first thing that cannot be used: file, key, frame, and the expected form.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(
            f"{folder}: no such folder; expected a subject with video.mp4 or frames/, masks/, "
            "cameras.npz and poses.npz"
        )
    cameras = load_cameras(folder / "cameras.npz")
    images, count = _open_pictures(folder)
    pose, shape = load_poses(poses or folder / "poses.npz")
    if len(pose) != count:
        raise InputError(
            f"{poses or folder / 'poses.npz'}: holds {len(pose)} frames, but the video has {count}"
        )
    if len(cameras) == 1:
        cameras = cameras * count
    if len(cameras) != count:
        raise InputError(
            f"{folder / 'cameras.npz'}: holds {len(cameras)} cameras, "
            f"but the video has {count} frames"
        )
    size = (cameras[0].height, cameras[0].width)
    for k in range(count):
        shape_k = (
            images[k].shape[:2]
            if images
            else read_image(_picture(folder / "frames", k), 3).shape[:2]
        )
        if shape_k != size:
            raise InputError(
                f"{folder}: frame {k} is {shape_k[1]}x{shape_k[0]}, "
                f"but cameras.npz says {size[1]}x{size[0]}"
            )
        _check_mask(_picture(folder / "masks", k), k, size)
    normals = folder / "normals"
    if normals.is_dir():
        for k in range(count):
            shape_k = read_normals(normals, k).shape
            if shape_k != (*size, 3):
                raise InputError(f"{normals}: frame {k} is {shape_k}, expected {(*size, 3)}")
    return Video(folder, cameras, pose, shape, load_splits(folder, count), images, normals.is_dir())


def load_cameras(path: Path) -> list[Camera]:
    """Read ``cameras.npz``; one camera stands for all frames.

    Raises:
        InputError: a missing file or key, or a wrong shape.
    """
    data = read_arrays(path, "K, T_camera_world, width, height (.npz)")
    require_keys(path, data, ("K", "T_camera_world", "width", "height"))
    K, T = data["K"], data["T_camera_world"]
    for name, value, shape in (("K", K, (3, 3)), ("T_camera_world", T, (4, 4))):
        if value.shape[-2:] != shape or value.ndim not in (2, 3):
            raise InputError(
                f"{path}: '{name}' must be {shape} or (T, *{shape}), got {value.shape}"
            )
        if not np.issubdtype(value.dtype, np.number) or not np.isfinite(value).all():
            raise InputError(f"{path}: '{name}' must hold finite numbers")
    count = max(len(x) if x.ndim == 3 else 1 for x in (K, T))
    K, T = np.broadcast_to(K, (count, 3, 3)), np.broadcast_to(T, (count, 4, 4))
    width, height = int(data["width"]), int(data["height"])
    try:
        return [Camera.from_matrices(K[k], T[k], width, height) for k in range(count)]
    except ValueError as error:
        raise InputError(f"{path}: {error}") from None


def save_cameras(path: Path, cameras: Sequence[Camera]) -> None:
    """Write ``cameras.npz``; equal cameras are written once."""
    K = np.stack([c.K for c in cameras])
    T = np.stack([c.T_camera_world for c in cameras])
    if (K == K[:1]).all() and (T == T[:1]).all():
        K, T = K[0], T[0]
    size = {"width": np.array(cameras[0].width), "height": np.array(cameras[0].height)}
    write_arrays(path, K=K, T_camera_world=T, **size)


def load_splits(folder: Path, frames: int) -> Splits:
    """Read ``splits.json``; without it, every 8th frame is a test frame.

    Raises:
        InputError: unreadable, a frame that does not exist, or one in both lists.
    """
    path = folder / "splits.json"
    if not path.exists():
        return Splits.every(TEST_EVERY, frames)
    try:
        data = json.loads(path.read_text())
        train, test = [int(k) for k in data["train"]], [int(k) for k in data["test"]]
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f'{path}: expected {{"train": [...], "test": [...]}} of frame numbers ({error!r})'
        ) from None
    outside = [k for k in (*train, *test) if not 0 <= k < frames]
    both = sorted(set(train) & set(test))
    if outside or both or not train:
        reason = (
            f"frame {outside[0]} does not exist"
            if outside
            else f"frame {both[0]} is in both"
            if both
            else "no train frame"
        )
        raise InputError(f"{path}: {reason}; the video has frames 0 to {frames - 1}")
    return Splits(train, test)


def _picture(folder: Path, index: int) -> Path:
    return folder / f"{index:06d}.png"


def _open_pictures(folder: Path) -> tuple[Sequence[np.ndarray], int]:
    frames = sorted((folder / "frames").glob("*.png"))
    if frames:
        for k, path in enumerate(frames):
            if path.name != f"{k:06d}.png":
                raise InputError(
                    f"{path}: frames must be numbered without gaps; {k:06d}.png was expected"
                )
        return [], len(frames)
    if (folder / "video.mp4").exists():
        images = read_movie(folder / "video.mp4")
        return images, len(images)
    raise InputError(f"{folder}: neither frames/000000.png ... nor video.mp4 is there")


def _check_mask(path: Path, index: int, size: tuple[int, int]) -> None:
    mask = read_image(path, 1)
    if mask.shape != size:
        raise InputError(
            f"{path}: mask of frame {index} is {mask.shape[1]}x{mask.shape[0]}, "
            f"expected {size[1]}x{size[0]}"
        )
    if not (mask > 127).any():
        raise InputError(
            f"{path}: mask of frame {index} is empty; expected the person in it (255 inside)"
        )
