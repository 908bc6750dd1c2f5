"""What drives an avatar: the motion that ``render``, ``export`` and ``view`` are given."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import torch
from torch.nn.functional import pad

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.pose import Pose, Shape, is_pose_file
from gva_mi.console import say
from gva_mi.data.importers.motions import MotionOptions, read_motion
from gva_mi.data.importers.target import TargetBody
from gva_mi.fit.run_folder import load_motion


def motion_of(
    run: Path, avatar: Avatar, given: Path | None, fps: float, body: Path | None
) -> tuple[Pose, Shape]:
    """The motion that ``--poses`` names; without it the poses that were trained with the avatar.

    Of a motion of AMASS and the like, which is brought to the avatar's conventions, a line says
    what it was taken for; of another person's, what becomes of it.

    Args:
        run: folder of a run, or an avatar's file.
        avatar: that is driven.
        given: a file of poses, or any motion that ``gva-mi motion`` reads.
        fps: frames a second that such a motion is resampled to; poses are played as they are.
        body: the file of the avatar's body, whose hands components of a PCA weigh.

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
    own = avatar.rig.betas
    count = max(len(own), len(shape.betas))
    one, two = (pad(x.double(), (0, count - len(x))) for x in (own, shape.betas))
    if not torch.allclose(one, two, atol=1e-4):
        say(
            f"{path}: poses of a person of another shape, driven as they are: joints turn and the "
            "root moves as there, bones keep the avatar's lengths, so feet may slide or float"
        )
    return pose, shape
