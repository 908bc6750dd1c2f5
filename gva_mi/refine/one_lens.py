"""Place a person before one lens, if an estimator saw every frame through another lens.

Some estimators assume another lens in each frame. Their poses jump by metres from frame to frame
while the person stands still (:mod:`gva_mi.readers.track`), and the prior would take that for
errors and for motion. So the person is placed before the median lens, where the pictures show the
same (:func:`before_one_lens`), refined there, and placed back (:func:`moved_between_lenses`). The
lenses differ by some percent: nothing else in the pictures changes visibly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from gva_mi.body.pose import Pose, Shape
from gva_mi.body.rotations import composed, shortest
from gva_mi.body.smplx import BodyModel
from gva_mi.splat import Camera
from gva_mi.subject.lens import is_one_lens, seen_alike
from gva_mi.subject.video import Video


def before_one_lens(video: Video, body: BodyModel) -> Video:
    """Return the video with one lens in all frames, and with poses that look the same through it.

    A video with one lens is returned unchanged. So is a video whose person moves no less before one
    lens: its lenses are real, for example because the camera zooms.
    """
    K = np.stack([camera.K for camera in video.cameras])
    if is_one_lens(K):
        return video
    fx, fy, cx, cy = np.median(K[:, [0, 1, 0, 1], [0, 1, 2, 2]], axis=0).tolist()
    cameras = [replace(camera, fx=fx, fy=fy, cx=cx, cy=cy) for camera in video.cameras]
    pose = moved_between_lenses(video.pose, video.shape, body, video.cameras, cameras).to(
        torch.float32
    )
    if _usual_step(pose) >= _usual_step(video.pose):
        return video
    return replace(video, cameras=cameras, pose=pose)


def moved_between_lenses(
    pose: Pose,
    shape: Shape,
    body: BodyModel,
    cameras: Sequence[Camera],
    others: Sequence[Camera],
) -> Pose:
    """Return poses that look the same through ``others`` as these do through ``cameras``.

    The person turns with the ray on which the pelvis is seen.

    Args:
        pose: T frames.
        shape: of the person.
        body: of the poses.
        cameras: T of them.
        others: T cameras at the same places, with other lenses.
    """
    pelvis = body.rest(shape).joints[0].detach().double().numpy()
    T = np.stack([camera.T_camera_world for camera in cameras])
    R, t = T[:, :3, :3], T[:, :3, 3]
    K, K_others = (np.stack([camera.K for camera in some]) for some in (cameras, others))
    places = np.einsum("nij,nj->ni", R, pose.transl.double().numpy() + pelvis) + t
    moved = seen_alike(places, K, K_others)
    back = lambda x: np.einsum("nji,nj->ni", R, x)
    rotations = pose.rotations.double().numpy().copy()
    rotations[:, 0] = composed(back(shortest(places, moved)), rotations[:, 0])
    tensor = lambda x: torch.from_numpy(x).to(pose.transl)
    return Pose(tensor(rotations), tensor(back(moved - t) - pelvis), pose.expression)


def _usual_step(pose: Pose) -> float:
    """Return the median step of the root from frame to frame, metres; 0 for a single frame."""
    steps = pose.transl.diff(dim=0).norm(dim=1)
    return float(steps.median()) if len(steps) else 0.0
