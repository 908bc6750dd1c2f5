"""Refine a person whom an estimator saw through another lens in each frame before one lens.

Such poses jump by metres from frame to frame while the person stands still
(:mod:`gva_mi.data.importers.one_lens`), and the prior would take that for errors and for motion. So
the person is placed before the median lens, where the pictures show the same, refined there, and
placed back. The lenses differ by some percent: nothing else in the pictures changes visibly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from gva_mi.body.pose import Pose, Shape
from gva_mi.body.rotations import composed, shortest
from gva_mi.body.smplx import BodyModel
from gva_mi.data.importers.one_lens import is_one_lens, seen_alike
from gva_mi.data.video import Video
from gva_mi.pose.observed_video import Refined
from gva_mi.splat import Camera


def before_one_lens(video: Video, body: BodyModel) -> Video:
    """Return the video with one lens in all frames, and with poses that look the same through it.

    A video of one lens is returned as it is. So is one whose person moves no less before one lens:
    its lenses are real, as of a camera that zooms.
    """
    K = _lenses(video.cameras)
    if is_one_lens(K):
        return video
    fx, fy, cx, cy = np.median(K[:, [0, 1, 0, 1], [0, 1, 2, 2]], axis=0).tolist()
    cameras = [replace(camera, fx=fx, fy=fy, cx=cx, cy=cy) for camera in video.cameras]
    pose = _seen_by(cameras, video.pose, video.shape, body, video.cameras).to(torch.float32)
    if _usual_step(pose) >= _usual_step(video.pose):
        return video
    return replace(video, cameras=cameras, pose=pose)


def as_filmed(refined: Refined, before: Video, video: Video, body: BodyModel) -> Refined:
    """Return what was found before one lens for the lenses of the video as it was filmed."""
    if before is video:
        return refined
    pose = _seen_by(video.cameras, refined.pose, refined.shape, body, before.cameras)
    return replace(refined, pose=pose)


def _seen_by(
    others: Sequence[Camera],
    pose: Pose,
    shape: Shape,
    body: BodyModel,
    cameras: Sequence[Camera],
) -> Pose:
    """Return the poses that other cameras, at the same places, see as ``cameras`` see these.

    The person turns with the ray on which the pelvis is seen.
    """
    pelvis = body.rest(shape).joints[0].detach().double().numpy()
    T = np.stack([camera.T_camera_world for camera in cameras])
    R, t = T[:, :3, :3], T[:, :3, 3]
    places = np.einsum("nij,nj->ni", R, pose.transl.double().numpy() + pelvis) + t
    moved = seen_alike(places, _lenses(cameras), _lenses(others))
    back = lambda x: np.einsum("nji,nj->ni", R, x)
    rotations = pose.rotations.double().numpy().copy()
    rotations[:, 0] = composed(back(shortest(places, moved)), rotations[:, 0])
    tensor = lambda x: torch.from_numpy(x).to(pose.transl)
    return Pose(tensor(rotations), tensor(back(moved - t) - pelvis), pose.expression)


def _usual_step(pose: Pose) -> float:
    """Return the median way of the root from frame to frame, metres; 0 for a single frame."""
    steps = pose.transl.diff(dim=0).norm(dim=1)
    return float(steps.median()) if len(steps) else 0.0


def _lenses(cameras: Sequence[Camera]) -> np.ndarray:
    return np.stack([camera.K for camera in cameras])
