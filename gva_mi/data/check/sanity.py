"""A quick sanity check before hours of work: does the person stand where the masks are?

``gva-mi check`` is thorough but slow. This check is quick and finds gross faults: an inverted
T_camera_world, a body in millimetres, masks of another place, inverted masks.
Joints beyond the picture's edge are ignored, because many videos end at the hips.
"""

from __future__ import annotations

import torch

from gva_mi.body.pose import BODY
from gva_mi.body.smplx import BodyModel
from gva_mi.data.joints import count_in_mask, joints_seen
from gva_mi.data.video import Video, spread

FRAMES = 8  # that are read
FEWEST_INSIDE = 0.5  # of those in the picture; noise and loose clothes leave most in the masks
FEWEST_SEEN = 0.2  # of all joints are in the picture; head and shoulders are a third of them


@torch.no_grad()
def sanity_check(video: Video, body: BodyModel) -> str | None:
    """Return a warning if the video's body does not stand where its masks are, else None."""
    inside, seen, of = 0, 0, 0
    frames = [k for k in range(len(video)) if k not in video.absent]
    for outline in video.outlines(spread(frames, FRAMES)):
        joints = body(outline.pose, video.shape).joints[0, : BODY.stop].double().numpy()
        hits, there = count_in_mask(joints_seen(outline.camera, joints), outline.mask > 0.5)
        inside, seen, of = inside + hits, seen + there, of + len(joints)
    share, where = seen / max(1, of), "picture"
    if share >= FEWEST_SEEN:
        share, where = inside / seen, "masks"
        if share >= FEWEST_INSIDE:
            return None
    return (
        f"{video.folder}: doubtful: {share:.0%} of the body's joints lie in the {where}, expected "
        f"most of them; gva-mi check {video.folder} looks for the cause"
    )
