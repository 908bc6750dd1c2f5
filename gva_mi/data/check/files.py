"""Read each file of a subject's folder on its own; an unreadable file becomes a problem.

:func:`gva_mi.data.video.load_video` stops at the first file that it cannot use.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import numpy as np

from gva_mi.body.pose import PoseFile, load_offsets, read_pose_file
from gva_mi.body.smplx import BodyModel
from gva_mi.core.console import Progress
from gva_mi.core.errors import InputError
from gva_mi.data.cameras import load_cameras
from gva_mi.data.check.numbers import check_intrinsics
from gva_mi.data.check.problems import Problem, doubt, error
from gva_mi.data.film import Film
from gva_mi.data.fingerprint import require_same_body
from gva_mi.data.folder import CAMERAS, NORMALS_RECORD, POSES, frame_name, is_frame_name
from gva_mi.data.masks import read_mask
from gva_mi.data.normals import NormalMaps
from gva_mi.data.pictures import read_image, size_of_whole
from gva_mi.data.splits import load_splits
from gva_mi.data.views import read_views
from gva_mi.splat import Camera

T = TypeVar("T")
SMALL = 192  # px, longer side of the masks that are compared: a person of 1.8 m has 1 px a cm
FULL = 0.995  # of a picture: what is missing is noise of a file's compression
# A person touches one side of the border, or two if head and feet are cut off; what is around the
# person touches all four.
AROUND = 0.5  # of the border


@dataclass(frozen=True)
class MaskSummary:
    """Small version of a mask, and the measurements of it that the checks need."""

    size: tuple[int, int]  # (W, H)
    small: np.ndarray  # (h, w) bool, at most SMALL pixels long
    share: float  # of its pixels that are inside
    border: float  # of the picture's border that is inside
    greatest: float  # value

    @property
    def inverted(self) -> bool:
        """Whether the mask shows the background instead of the person."""
        return AROUND < self.border and self.share < FULL


@dataclass
class SubjectFiles:
    """The readable content of a subject's folder."""

    folder: Path
    poses_file: Path
    pictures: dict[int, tuple[int, int]] = field(default_factory=dict)  # (W, H) of each
    film: Sequence[np.ndarray] = ()  # if the pictures come as one
    masks: dict[int, MaskSummary] = field(default_factory=dict)
    cameras: dict[int, Camera] = field(default_factory=dict)  # of each picture
    poses: PoseFile | None = None
    maps: NormalMaps | None = None
    problems: list[Problem] = field(default_factory=list)

    @property
    def count(self) -> int:
        """Number of frames of the video, missing ones included."""
        return max(self.pictures, default=-1) + 1

    def picture(self, index: int) -> np.ndarray:
        """Read a frame, (H, W, 3) 8-bit."""
        if len(self.film):
            return self.film[index]
        return read_image(self.folder / "frames" / frame_name(index), 3)

    def attempt(
        self, what: str, read: Callable[[], T], cause: str = "missing, cut short, or of another "
        "form", remedy: str = "write it again in the form that docs/own_video.md describes",
    ) -> T | None:  # fmt: skip
        """Call ``read``; if it fails, record a problem and return None."""
        try:
            return read()
        except InputError as reason:
            self.problems.append(error(what, str(reason), cause, remedy))
            return None


def read_subject(
    folder: Path, poses: Path | None, body: BodyModel, progress: Progress | None
) -> SubjectFiles:
    """Read a folder."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; expected a subject's")
    parts = ("video.mp4", "frames", "masks", CAMERAS, POSES)
    if not any((folder / part).exists() for part in parts):
        raise InputError(f"{folder}: no subject's folder; expected some of {', '.join(parts)}")
    files = SubjectFiles(folder, poses or folder / POSES)
    _read_pictures(files)
    for done, k in enumerate(sorted(files.pictures), 1):
        if progress is not None:
            progress(done, len(files.pictures))
        mask = files.attempt("unreadable", lambda k=k: read_mask(folder / "masks", k))
        if mask is not None and mask.size:
            files.masks[k] = _summary(mask)
    _read_poses(files, body)
    _read_cameras(files)
    files.problems += _sizes_and_masks(files)
    if files.count:
        files.attempt("splits", lambda: load_splits(folder, files.count))
        files.attempt(
            "views of other cameras", lambda: read_views(folder, files.count),
            "files were lost, or of another video", "prepare the folder again with --views",
        )  # fmt: skip
    files.attempt(
        "another body", lambda: require_same_body(folder, body),
        "poses of one body on another are other poses", "give the --body that the folder is for",
    )  # fmt: skip
    _open_normals(files)
    return files


def _read_pictures(files: SubjectFiles) -> None:
    folder = files.folder
    paths = sorted((folder / "frames").glob("*.png"))
    misnamed = [p.name for p in paths if not is_frame_name(p)]
    if misnamed:
        files.problems.append(
            error("frames named otherwise", f"{len(misnamed)}, such as {misnamed[0]}",
                  "numbered by another program", "name them 000000.png, 000001.png, ...")
        )  # fmt: skip
    for path in paths:
        if path.name not in misnamed:
            size = files.attempt("unreadable", lambda path=path: size_of_whole(path))
            if size is not None:
                files.pictures[int(path.stem)] = size
    film = folder / "video.mp4"
    if not paths and film.exists():
        files.film = files.attempt("unreadable", lambda: Film(film)) or ()
        files.pictures = dict(enumerate(getattr(files.film, "sizes", ())))
    elif not paths:
        files.problems.append(
            error("no pictures", "0 frames", "neither frames/ nor video.mp4 is there",
                  "put video.mp4 or frames/000000.png ... into the folder")
        )  # fmt: skip


def _summary(mask: np.ndarray) -> MaskSummary:
    height, width = mask.shape
    inside = mask > 0.5
    border = np.concatenate([inside[0], inside[-1], inside[:, 0], inside[:, -1]])
    small = shrunk(inside, small_size(width, height))
    share, edge = float(inside.mean()), float(border.mean())
    return MaskSummary((width, height), small, share, edge, float(mask.max()))


def shrunk(mask: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return a mask (H, W) bool in ``size`` (w, h), (h, w) bool."""
    from PIL import Image

    small = Image.fromarray(mask.astype(np.float32)).resize(size, Image.Resampling.BOX)
    return np.asarray(small) > 0.5


def small_size(width: int, height: int, longer: int = SMALL) -> tuple[int, int]:
    """Return the reduced size (w, h), ``longer`` at most, at which a picture is compared."""
    scale = min(1.0, longer / max(width, height))
    return max(1, round(width * scale)), max(1, round(height * scale))


def _read_poses(files: SubjectFiles, body: BodyModel) -> None:
    path = files.poses_file
    files.poses = files.attempt("unreadable", lambda: read_pose_file(path))
    if files.poses is None:
        return
    files.attempt("unreadable", lambda: load_offsets(path, len(body.v_template)))
    betas = files.poses.shape.betas
    if betas[body.num_betas :].any():
        files.problems.append(
            error("betas", f"{len(betas)}, the body has {body.num_betas}", "they belong to another "
                  "body", "give the --body that they belong to")
        )  # fmt: skip
        files.poses = None
    elif files.count and len(files.poses.pose) != files.count:
        files.problems.append(_other_count(path.name, len(files.poses.pose), files.count))


def _read_cameras(files: SubjectFiles) -> None:
    path = files.folder / CAMERAS
    found = files.attempt("unreadable", lambda: load_cameras(path))
    if found is None:
        return
    if len(found) == 1:
        found = found * max(1, files.count)
    if files.count and len(found) != files.count:
        files.problems.append(_other_count(path.name, len(found), files.count))
    files.problems += check_intrinsics(found)
    files.cameras = {k: c for k, c in enumerate(found) if k in files.pictures}


def _other_count(name: str, length: int, count: int) -> Problem:
    return error(
        "counts", f"{name}: {length} frames, the video has {count}",
        "the estimator dropped frames, or another frame rate was extracted",
        "make poses and cameras of exactly these frames",
    )  # fmt: skip


def _sizes_and_masks(files: SubjectFiles) -> Iterator[Problem]:
    there, masks, count = files.pictures, files.masks, files.count
    if gaps := [k for k in range(count) if k not in there]:
        yield doubt("missing pictures", f"{len(gaps)} of {count}", "frames were lost, or numbered "
                    "with a step", "number frames, masks and poses 0, 1, 2, ...", gaps)  # fmt: skip
    sizes = {k: (c.width, c.height) for k, c in files.cameras.items()}
    of_masks = {k: m.size for k, m in masks.items()}
    each = ("picture size", there, sizes), ("mask size", of_masks, sizes or there)
    for what, found, wanted in each:
        if other := [k for k, size in found.items() if size != wanted.get(k, size)]:
            (w, h), (W, H) = found[other[0]], wanted[other[0]]
            yield error(what, f"{w}x{h}, expected {W}x{H}", "one of them was shrunk or turned",
                        "scale frames, masks and K together", other)  # fmt: skip
    for what, severity, chosen, cause, remedy in (
        ("missing masks", doubt, [k for k in there if k not in masks],
         "the segmenter gave none, or its files have other names",
         "write masks/000000.png ...; frames without one are left out"),
        ("empty masks", doubt, [k for k, m in masks.items() if m.share == 0],
         "the segmenter lost the person, or wrote labels", "write 255 where the person is"),
        ("full masks", error, [k for k, m in masks.items() if m.share >= FULL],
         "an alpha channel that was never written, or a threshold of zero",
         "make these masks again, or delete them: frames without one are left out"),
        ("inverted masks", error, [k for k, m in masks.items() if m.inverted],
         "255 is the background", "write 255 where the person is"),
    ):  # fmt: skip
        if chosen:
            problem = error if len(chosen) == len(there) else severity
            greatest = max((masks[k].greatest for k in chosen if k in masks), default=None)
            figure = f"{len(chosen)} of {len(there)}"
            figure += "" if greatest is None else f", greatest value {greatest:.2g} of 1"
            yield problem(what, figure, cause, remedy, chosen)


def _open_normals(files: SubjectFiles) -> None:
    cause = "maps of a crop, or of another size"
    remedy = f"write maps of the frame's size, or the crop's 'boxes' into {NORMALS_RECORD}"
    what = "normals cannot be read"
    opened = files.attempt(
        what, lambda: NormalMaps.open(files.folder, max(1, files.count)), cause, remedy
    )
    if opened is None:
        return
    reasons: dict[int, str] = {}
    for k, camera in files.cameras.items():
        try:
            opened.check(k, camera)
        except InputError as reason:
            reasons[k] = str(reason)
    if reasons:
        first = next(iter(reasons.values()))
        files.problems.append(error(what, first, cause, remedy, reasons))
    if len(reasons) < len(files.cameras):
        files.maps = opened
