"""A quick sanity check before hours of work: does the person stand where the masks are?

``gva-mi check`` is thorough but slow. This check is quick and finds gross faults: an inverted
T_camera_world, a body in millimetres or far away, masks of another place, inverted masks.
Joints beyond the picture's edge are ignored, because many videos end at the hips.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch

from gva_mi.body.pose import BODY, Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.data.check.files import shrunk, small_size
from gva_mi.data.joints import count_in_mask, joints_seen
from gva_mi.data.splits import spread
from gva_mi.data.video import Video
from gva_mi.splat import Camera

COMPARED = 8  # that are read
FEWEST_INSIDE = 0.5  # of those in the picture; noise and loose clothes leave most in the masks
LEAST_OVERLAP = 0.25  # IoU; wide clothes and occlusion leave more
COARSE = 48  # px, longer side: vertices of a body are as dense
FEWEST_SEEN = 0.2  # of all joints are in the picture; head and shoulders are a third of them


def sanity_check(video: Video, body: BodyModel) -> str | None:
    """Return a warning if the video's body does not stand where its masks are, else None."""
    frames = [k for k in range(len(video)) if k not in video.absent]
    outlines = video.outlines(spread(frames, COMPARED))
    doubt = doubt_of(((x.pose, x.camera, x.mask) for x in outlines), video.shape, body)
    check = f"gva-mi check {video.folder} looks for the cause"
    return None if doubt is None else f"{video.folder}: {doubt}; {check}"


@torch.no_grad()
def doubt_of(
    frames: Iterable[tuple[Pose, Camera, np.ndarray]], shape: Shape, body: BodyModel
) -> str | None:
    """Return a doubt if the body is not where the masks (H, W) of frames are, else None."""
    inside, seen, of, both, either = 0, 0, 0, 0, 0
    for pose, camera, mask in frames:
        posed = body(pose, shape)
        joints = posed.joints[0, : BODY.stop].double().numpy()
        hits, there = count_in_mask(joints_seen(camera, joints), mask > 0.5)
        inside, seen, of = inside + hits, seen + there, of + len(joints)
        size = small_size(camera.width, camera.height, COARSE)
        pixels = joints_seen(camera.resized(*size), posed.vertices[0].double().numpy())
        whole = np.floor(np.nan_to_num(pixels, nan=-1.0, posinf=-1.0, neginf=-1.0)).astype(int)
        x, y = whole[((whole >= 0) & (whole < size)).all(1)].T
        shown = np.zeros(size[::-1], bool)  # pixels that hold a vertex
        shown[y, x] = True
        there = shrunk(mask > 0.5, size)
        both, either = both + (shown & there).sum(), either + (shown | there).sum()
    if not of:
        return None
    share, overlap = inside / max(1, seen), both / max(1, either)
    if seen < FEWEST_SEEN * of:
        figure = f"{seen / of:.0%} of the body's joints lie in the picture"
    elif share < FEWEST_INSIDE:
        figure = f"{share:.0%} of the body's joints lie in the masks"
    elif overlap < LEAST_OVERLAP:
        return f"doubtful: {overlap:.0%} of the body and of the masks is in both, expected half"
    else:
        return None
    return f"doubtful: {figure}, expected most of them"
