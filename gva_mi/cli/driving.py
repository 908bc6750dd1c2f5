"""The motion that drives an avatar in ``render``, ``export`` and ``view``."""

from __future__ import annotations

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

    A motion that ``gva-mi motion`` reads is resampled to ``fps`` frames a second, and its notes are
    printed; poses are played as they are. The file of the avatar's ``body`` is needed for hands
    given as PCA components.
    """
    if given is None or is_pose_file(given):
        pose, shape, path = load_motion(run, given)
    else:
        found, path = read_motion(given, TargetBody.read(body), MotionOptions(fps=fps)), given
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
