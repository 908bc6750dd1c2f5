"""A quick sanity check before hours of work: does the person stand where the masks are?

``gva-mi check`` is thorough but slow. This check is quick and finds gross faults: an inverted
T_camera_world, a body in millimetres or far away, masks of another place, inverted masks.
Joints beyond the picture's edge are ignored, because many videos end at the hips.
"""

from __future__ import annotations

import numpy as np
import torch

from gva_mi.body.pose import BODY
from gva_mi.body.smplx import BodyModel
from gva_mi.data.joints import count_in_mask, joints_seen
from gva_mi.data.video import Video, spread

FRAMES = 8  # that are read
FEWEST_INSIDE = 0.5  # of those in the picture; noise and loose clothes leave most in the masks
SMALLEST = 1 / 3  # of the masks' longer side that the joints of a body in the picture span
FEWEST_SEEN = 0.2  # of all joints are in the picture; head and shoulders are a third of them


@torch.no_grad()
def sanity_check(video: Video, body: BodyModel) -> str | None:
    """Return a warning if the video's body does not stand where its masks are, else None."""
    inside, seen, of, sizes = 0, 0, 0, []
    frames = [k for k in range(len(video)) if k not in video.absent]
    for outline in video.outlines(spread(frames, FRAMES)):
        joints = body(outline.pose, video.shape).joints[0, : BODY.stop].double().numpy()
        pixels, mask = joints_seen(outline.camera, joints), outline.mask > 0.5
        hits, there = count_in_mask(pixels, mask)
        inside, seen, of = inside + hits, seen + there, of + len(joints)
        if 2 * there > len(joints):
            extent = max(np.ptp(part) + 1 for part in np.nonzero(mask))
            sizes.append(np.ptp(pixels, axis=0).max() / extent)
    if seen < FEWEST_SEEN * of:
        doubt = f"{seen / of:.0%} of the body's joints lie in the picture, expected most of them"
    elif inside < FEWEST_INSIDE * seen:
        doubt = f"{inside / seen:.0%} of the body's joints lie in the masks, expected most of them"
    elif sizes and np.median(sizes) < SMALLEST:
        doubt = f"the body's joints span {np.median(sizes):.1%} of the masks, expected most of them"
    else:
        return None
    return f"{video.folder}: doubtful: {doubt}; gva-mi check {video.folder} looks for the cause"
