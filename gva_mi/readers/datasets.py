"""Data sets with pictures and masks of their own: :data:`DATASETS` has one record for each.

Their formats follow the public code of zju3dv/neuralbody and tijiang13/InstantAvatar;
``docs/sources.md`` lists the files. To add a data set, add a record: the files that recognise its
folder, and a function that reads a :class:`Capture`.

Poses are in a world, and a camera's extrinsic matrix E = [R T] maps it to the camera. One of
several cameras, ``--camera``, becomes the video. Others can be held out as views of the subject
(:mod:`gva_mi.subject.ground_truth`): if W turns the video's camera upright,

    E_subject = E E_video⁻¹ W.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from gva_mi.body.rotations import nearest_rotations
from gva_mi.core.errors import InputError, expecting
from gva_mi.core.files import read_arrays, require_keys
from gva_mi.readers.source_files import read_source
from gva_mi.readers.target_body import TargetBody
from gva_mi.readers.track import Track, make_track
from gva_mi.splat import Camera
from gva_mi.subject.folder import SubjectWriter
from gva_mi.subject.footage import Pictures, files_of, masks, pictures
from gva_mi.subject.lens import undistort
from gva_mi.subject.masks import MaskMeaning
from gva_mi.subject.pictures import require_sides
from gva_mi.subject.splits import spread

ALL_CAMERAS = "all"  # given instead of the cameras' names
FRAMES_PER_VIEW = 8  # at most, evenly spaced, of each held-out camera. Chosen for evaluation time
# Added to K: in OpenCV the first pixel's centre is 0, here it is 0.5.
_OPENCV_PIXEL_SHIFT = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])


@dataclass(frozen=True)
class FixedCamera:
    """One of a data set's cameras: x_cam = R x + T."""

    frames: Sequence[Path]
    masks: Sequence[Path]  # of the frames; some may be missing
    K: np.ndarray  # (3, 3) pixels
    R: np.ndarray  # (3, 3)
    T: np.ndarray  # (3,) metres
    distortion: np.ndarray  # (k1, k2, p1, p2, k3); zeros: a pinhole

    @property
    def extrinsic(self) -> np.ndarray:
        """E (4, 4)."""
        E = np.eye(4)
        E[:3, :3], E[:3, 3] = nearest_rotations(self.R), self.T
        return E

    def shows(self, frame: int) -> bool:
        """Whether a frame has a picture and a mask."""
        return frame < len(self.frames) and all(
            path.is_file() for path in (self.frames[frame], self.masks[frame])
        )


@dataclass(frozen=True)
class Capture:
    """People, and the pictures that show them."""

    tracks: list[Track]
    frames: Pictures
    masks: Pictures | None  # None: the source has none
    distortion: np.ndarray | None = None  # (k1, k2, p1, p2, k3) of the lens; None: a pinhole
    meaning: MaskMeaning | None = None  # of the masks' values; None: unknown
    counts_may_differ: bool = False  # of pictures, masks and poses: the smallest count is used
    note: str = ""
    size: Sequence[int] = ()  # (W, H) of the pictures that K is of, if recorded
    video_camera: FixedCamera | None = None  # the one that becomes the video, of several
    other_cameras: Mapping[str, Callable[[], FixedCamera]] = field(default_factory=dict)  # by name

    def read_masks(self, source: Pictures | None = None) -> Iterator[np.ndarray]:
        """Yield the data set's masks, or those of another source, with 255 inside."""
        return masks(source or self.masks, self.meaning)


@dataclass(frozen=True)
class DataSet:
    """Rules that recognise and read a data set's folder."""

    files: tuple[str, ...]  # that its folder holds; "a|b" means a or b
    read: Callable[[Path, str | None, TargetBody], Capture]  # folder, name of the camera, body
    expects: str  # for messages

    def recognises(self, folder: Path) -> bool:
        """Whether a folder holds the files of this data set."""
        return all(any((folder / x).exists() for x in name.split("|")) for name in self.files)


def dataset_of(folder: Path) -> str | None:
    """Return the kind of data set in a folder; None for any other folder."""
    return next((kind for kind, record in DATASETS.items() if record.recognises(folder)), None)


def read_dataset(kind: str, folder: Path, camera: str | None, body: TargetBody) -> Capture:
    """Read people, pictures and masks from a data set's folder of one subject.

    ``camera`` names the one that becomes the video; None: the first. Poses are for ``body``.
    """
    record = DATASETS[kind]
    if not record.recognises(folder):
        raise InputError(
            f"{folder}: not a data set of {kind}; expected a folder with {record.expects}"
        )
    with expecting(f"{folder} (read as {kind})", record.expects):
        return record.read(folder, camera, body)


def _instantavatar(folder: Path, camera: str | None, body: TargetBody) -> Capture:
    path = folder / "cameras.npz"
    lens = read_arrays(path, "intrinsic and extrinsic")
    require_keys(path, lens, ("intrinsic", "extrinsic"))
    path = folder / "poses_optimized.npz"
    path = path if path.is_file() else folder / "poses.npz"
    poses = read_arrays(path, "thetas, transl and betas")
    require_keys(path, poses, ("transl", "betas"))
    K, T = (np.asarray(lens[name], np.float64) for name in ("intrinsic", "extrinsic"))
    track = make_track(str(path), "0", None, poses, K[:3, :3], body)
    track = track.seen_from(T[:3, :3], T[:3, 3])
    images = tuple(files_of(folder / "images"))
    size = [int(lens[x]) for x in ("width", "height")] if {"width", "height"} <= set(lens) else ()
    return Capture([track], images, folder / "masks", counts_may_differ=True, size=size)


def _zju(folder: Path, camera: str | None, body: TargetBody) -> Capture:
    found = read_source(folder / "annots.npy", "cams and ims, as ZJU-MoCap has them")
    names = [str(k) for k in range(len(found["cams"]["K"]))]
    name = names[0] if camera is None else camera
    if name not in names:
        raise InputError(f"{folder}: has no camera '{name}'; it has {', '.join(names[:30])}")
    own = _zju_camera(folder, found, int(name))
    params = folder / ("new_params" if (folder / "new_params").is_dir() else "params")
    # 000010.jpg, or CoreView_313_Camera_(1)_0010_...jpg
    number = lambda path: int((path.stem.split("_")[4:] or [path.stem])[0])
    people = [
        read_source(params / f"{number(path)}.npy", "poses, shapes, Rh and Th of a frame")
        for path in own.frames
    ]
    given = {
        key: np.stack([np.ravel(np.asarray(person[key], np.float64)) for person in people])
        for key in ("poses", "Rh", "Th", "shapes")
    }
    track = make_track(str(folder), "0", None, given, own.K, body).seen_from(own.R, own.T)
    others = {k: lambda k=k: _zju_camera(folder, found, int(k)) for k in names if k != name}
    return Capture(
        [track], tuple(own.frames), tuple(own.masks), own.distortion, MaskMeaning(parts=True),
        note=f"camera {name} of {len(names)}; --camera takes another, --views holds others out",
        video_camera=own, other_cameras=others,
    )  # fmt: skip


def _zju_camera(folder: Path, found: Mapping[str, Any], k: int) -> FixedCamera:
    """Read ZJU-MoCap's k-th camera, whose T is in millimetres."""
    cams = {"D": np.zeros((k + 1, 5)), **found["cams"]}  # a pinhole's file may lack D
    K, D, R, T = (np.asarray(cams[key][k], np.float64) for key in "KDRT")
    names = [_inside(folder, frame["ims"][k]) for frame in found["ims"]]
    masks = folder / ("mask_cihp" if (folder / "mask_cihp").is_dir() else "mask")
    return FixedCamera(
        [folder / name for name in names],
        [(masks / name).with_suffix(".png") for name in names],
        K.reshape(3, 3) + _OPENCV_PIXEL_SHIFT, R.reshape(3, 3), T.ravel() / 1000, D.ravel(),
    )  # fmt: skip


def _inside(folder: Path, name: object) -> str:
    """Return a path that a file names; refuse a path that leaves the folder."""
    path = PurePosixPath(str(name))
    if path.is_absolute() or ".." in path.parts:
        raise InputError(f"{folder}: names the picture '{path}', which is outside of the folder")
    return str(path)


DATASETS = {
    "instantavatar": DataSet(
        ("cameras.npz", "images", "masks", "poses.npz|poses_optimized.npz"),
        _instantavatar,
        "cameras.npz, images/, masks/ and poses.npz",
    ),
    "zju": DataSet(("annots.npy",), _zju, "annots.npy, new_params/ and mask_cihp/"),
}


def known_names(where: str, capture: Capture, names: Sequence[str]) -> list[str]:
    """Return the names of the held-out cameras; "all" in ``names`` means every other camera."""
    others = capture.other_cameras
    names = list(others) if list(names) == [ALL_CAMERAS] and others else list(names)
    for name in names:
        if name not in others:
            some = ", ".join(list(others)[:30]) or "none"
            raise InputError(f"{where}: has no other camera '{name}' to hold out; it has {some}")
    return names


def write_views(
    writer: SubjectWriter,
    where: str,
    capture: Capture,
    names: Sequence[str],
    frames: Sequence[int],
    upright: np.ndarray,
) -> list[str]:
    """Write a subject's held-out views, and return notes.

    Each camera of ``names`` sees at most :data:`FRAMES_PER_VIEW` of ``frames``; ``upright`` is W
    (4, 4).
    """
    T_video = np.linalg.inv(capture.video_camera.extrinsic) @ upright
    shown: list[tuple[int, str, Camera]] = []  # frame, name and camera of each picture
    left_out = []
    for name in names:
        at = f"{where}: camera {name}"
        with expecting(at, "K, R, T and its pictures, as the first camera has them"):
            other = capture.other_cameras[name]()
            T = other.extrinsic @ T_video
            Camera.from_matrices(other.K, T, 1, 1)  # refuses what no camera has
        for k in spread([k for k in frames if other.shows(k)], FRAMES_PER_VIEW):
            image = next(pictures((other.frames[k],), 3))
            mask, size = next(capture.read_masks((other.masks[k],))), image.shape[1::-1]
            require_sides(f"{other.masks[k]}:", mask, *size)
            if shown and size != (shown[0][2].width, shown[0][2].height):
                left_out.append(name)
                break
            straight = undistort(at, other.K, other.distortion, size) or (lambda image: image)
            writer.views.frame(len(shown), straight(image))
            writer.views.mask(len(shown), straight(mask))
            shown.append((k, name, Camera.from_matrices(other.K, T, *size)))
    if not shown:
        raise InputError(f"{where}: other cameras have no picture and mask of the video's frames")
    numbers, seen_by, cameras = zip(*shown, strict=True)
    writer.views.cameras(cameras)
    writer.views_record(numbers, seen_by)
    notes = [f"{len(shown)} views held out, of cameras {', '.join(dict.fromkeys(seen_by))}"]
    if left_out:
        notes.append(
            f"cameras left out, because their pictures have another size: {', '.join(left_out)}"
        )
    return notes
