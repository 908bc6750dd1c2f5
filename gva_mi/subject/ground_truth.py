"""Read what only evaluation may see: ground truth of a synthetic subject, and held-out views.

Real people lie outside the shape space of any body model. So a synthetic subject may be rendered
with another body than the one that is fitted. Then the folder ``truth`` holds that body, too:

===============  ===============================================================================
``poses.npz``    poses and betas of the rendered body
``body.npz``     the rendered body in SMPL-X's format, unless it is the fitted one
``cameras.npz``  the true cameras, unless they are the video's
===============  ===============================================================================

All bodies have SMPL-X's 55 joints, which can be compared one by one. Rotations, betas and vertex
numbers have a meaning on their own body only.

**Held-out views** are frames of a video from other cameras at the same time::

    subject/
      views/
        frames/000000.png ...   8-bit RGB
        masks/000000.png ...    of the same person
        cameras.npz             a camera for each of these pictures, in the subject's world
        views.json              {"frames": [...], "cameras": [...]}: which frame of the video each
                                picture is of, and the name of the camera that saw it

The poses of a view are those of the opened video. (Synthetic subjects have their novel views in the
ground truth.)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from gva_mi.body.pose import Pose, Shape, load_poses
from gva_mi.body.smplx import BodyModel, load_body
from gva_mi.core.errors import InputError, expecting
from gva_mi.core.files import read_json
from gva_mi.splat import Camera
from gva_mi.subject.cameras import load_cameras
from gva_mi.subject.folder import CAMERAS, FRAMES, MASKS, POSES, VIEWS, VIEWS_RECORD, frame_name
from gva_mi.subject.masks import read_mask
from gva_mi.subject.pictures import read_image, require_sides
from gva_mi.subject.splits import Splits
from gva_mi.subject.video import Video

TRUE_BODY = "body.npz"  # of another body than the fitted one


@dataclass(frozen=True)
class GroundTruth:
    """The rendered synthetic subject: ``body(pose, shape)`` is the ground-truth surface."""

    body: BodyModel
    pose: Pose  # T frames
    shape: Shape
    cameras: list[Camera]  # one for each of the T frames
    foreign: bool = False  # the body is another one than the fitted one


def load_ground_truth(folder: Path, body: BodyModel, count: int | None = None) -> GroundTruth:
    """Read the ground truth of a synthetic video of ``count`` frames, in its folder ``truth``.

    ``body`` is the fitted body; it is also the rendered one unless the folder holds another.
    """
    pose, shape = load_poses(Path(folder) / POSES, count)
    file = Path(folder) / TRUE_BODY
    foreign = file.is_file()
    true = load_body(file, body.v_template.dtype) if foreign else body
    path = Path(folder) / CAMERAS
    path = path if path.is_file() else path.parents[1] / CAMERAS
    cameras = load_cameras(path, len(pose), " for {} poses")
    return GroundTruth(true, pose, shape, cameras, foreign)


def truth_of(video: Video, body: BodyModel) -> GroundTruth | None:
    """Read the ground truth of a video; None without one.

    Call it before a long computation, so that a bad file stops a command early.
    """
    if video.truth is None or not (video.truth / POSES).is_file():
        return None
    return load_ground_truth(video.truth, body, len(video))


def held_out_views(video: Video) -> Video | None:
    """Read the held-out views of a video, with its poses; None without such views."""
    found = read_views(video.folder, len(video))
    if found is None:
        return None
    frames, cameras = found
    return replace(
        video, folder=video.folder / VIEWS, cameras=cameras, pose=video.pose[frames], normals=None,
        absent={}, splits=Splits([], list(range(len(frames)))), _images=[],
    )  # fmt: skip


def read_views(subject: Path, count: int) -> tuple[list[int], list[Camera]] | None:
    """Read frame (of ``count``) and camera of each held-out picture; None without such views."""
    folder = subject / VIEWS
    if not folder.is_dir():
        return None
    path, expected = folder / VIEWS_RECORD, '{"frames": [...]}, the video\'s frame of each picture'
    found = read_json(path, expected)
    with expecting(path, expected):
        frames = found["frames"]
        if not frames or not all(type(k) is int and 0 <= k < count for k in frames):
            raise ValueError(f"the video has frames 0 to {count - 1}")
    cameras = load_cameras(folder / CAMERAS, len(frames), f" for {{}} pictures of {VIEWS_RECORD}")
    for k, camera in enumerate(cameras):
        image = read_image(folder / FRAMES / frame_name(k), 3)
        mask = read_mask(folder / MASKS, k)
        if mask is None:
            raise InputError(f"{folder}: has no mask {k}; expected one for each picture")
        for what, found in (("picture", image), ("mask", mask)):
            require_sides(f"{folder}: {what} {k}", found, camera.width, camera.height)
    return frames, cameras
