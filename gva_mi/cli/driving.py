"""The motion that drives an avatar in ``render``, ``export`` and ``view``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import torch
from torch.nn.functional import pad

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.pose import Pose, Shape, is_pose_file
from gva_mi.core.console import say
from gva_mi.data.importers.motions import MotionOptions, read_motion
from gva_mi.data.importers.target import TargetBody
from gva_mi.fit.run_folder import load_motion


def motion_of(
    run: Path, avatar: Avatar, given: Path | None, fps: float, body: Path | None
) -> tuple[Pose, Shape]:
    """Return the motion that ``--poses`` names; without it the poses trained with the avatar.

    Lines tell how a motion of another program was read, and that another person's bones are not
    used.

    Args:
        run: folder of a run, or an avatar's file.
        avatar: the avatar to be driven.
        given: a file of poses, or any motion that ``gva-mi motion`` reads.
        fps: frames a second that such a motion is resampled to; poses are played as they are.
        body: the file of the avatar's body, for hands given as PCA components.

    Raises:
        InputError: there are no poses, or they cannot be read.
    """
    if given is None or is_pose_file(given):
        pose, shape, path = load_motion(run, given)
    else:
        target = replace(TargetBody.read(body), joints=avatar.rig.joints.double().numpy())
        found, path = read_motion(given, target, MotionOptions(fps=fps)), given
        pose, shape = found.pose, found.shape
        for note in found.notes:
            say(f"{given}: {note}")
    count = max(len(avatar.rig.betas), len(shape.betas))
    own, theirs = (pad(x.double(), (0, count - len(x))) for x in (avatar.rig.betas, shape.betas))
    if not torch.allclose(own, theirs, atol=1e-4):
        say(
            f"{path}: poses of a person of another shape, driven as they are: joints turn and the "
            "root moves as there, bones keep the avatar's lengths, so feet may slide or float"
        )
    return pose, shape
