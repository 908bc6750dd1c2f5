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
from gva_mi.data.video import load_cameras
from gva_mi.splat import Camera

POSES, BODY, CAMERAS = "poses.npz", "body.npz", "cameras.npz"


@dataclass(frozen=True)
class GroundTruth:
    """The rendered synthetic subject: ``body(pose, shape)`` is the ground-truth surface."""

    body: BodyModel
    pose: Pose  # T frames
    shape: Shape
    cameras: list[Camera]  # one for each of the T frames
    foreign: bool = False  # the body is another one than the fitted one


def load_ground_truth(folder: Path, body: BodyModel) -> GroundTruth:
    """Read the ground truth of a synthetic video, in its folder ``truth``.

    ``body`` is the fitted body; it is also the rendered one unless the folder holds another.
    """
    pose, shape = load_poses(Path(folder) / POSES)
    file = Path(folder) / BODY
    foreign = file.is_file()
    true = load_body(file, body.v_template.dtype) if foreign else body
    own = Path(folder) / CAMERAS
    cameras = load_cameras(own if own.is_file() else own.parents[1] / CAMERAS)
    if len(cameras) == 1:
        cameras = cameras * len(pose)
    return GroundTruth(true, pose, shape, cameras, foreign)
