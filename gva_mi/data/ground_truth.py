"""Ground truth of a synthetic video: the rendered body, its poses, and the cameras.

The subject may be drawn on another body than the one that is fitted, because real people are not in
the span of any body model. Then the folder ``truth`` holds that body beside its poses:

===============  ===============================================================================
``poses.npz``    poses and betas of the body that was filmed
``body.npz``     that body, where it is not the fitted one; in SMPL-X's format
``cameras.npz``  the cameras, where the video's own may be off
===============  ===============================================================================

All bodies have SMPL-X's 55 joints, which can be compared one by one. Rotations, betas and vertex
numbers have a meaning on their own body only.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from gva_mi.body.pose import Pose, Shape, load_poses
from gva_mi.body.smplx import BodyModel, load_body
from gva_mi.data.cameras import load_cameras
from gva_mi.data.folder import CAMERAS, POSES
from gva_mi.data.video import Video
from gva_mi.splat import Camera

BODY = "body.npz"  # of another body than the fitted one


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
    file = Path(folder) / BODY
    foreign = file.is_file()
    true = load_body(file, body.v_template.dtype) if foreign else body
    own = Path(folder) / CAMERAS
    own = own if own.is_file() else own.parents[1] / CAMERAS
    cameras = load_cameras(own, len(pose), " for {} poses")
    return GroundTruth(true, pose, shape, cameras, foreign)


def truth_of(video: Video, body: BodyModel) -> GroundTruth | None:
    """Read the ground truth of a video; None without one.

    Commands call it before their work, so that a bad file does not cost the result.
    """
    if video.truth is None or not (video.truth / POSES).is_file():
        return None
    return load_ground_truth(video.truth, body, len(video))
