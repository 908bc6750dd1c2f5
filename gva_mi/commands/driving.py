"""What drives an avatar: the motion that ``render`` and ``export`` are given."""

from __future__ import annotations

from pathlib import Path

import torch
from torch.nn.functional import pad

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.pose import Pose, Shape
from gva_mi.console import say
from gva_mi.fit.run_folder import load_motion


def motion_of(run: Path, avatar: Avatar, given: Path | None) -> tuple[Pose, Shape]:
    """The motion that ``--poses`` names; without it the poses that were trained with the avatar.

    Of another person's motion a line says what becomes of it.
    """
    pose, shape, path = load_motion(run, given)
    own = avatar.rig.betas
    count = max(len(own), len(shape.betas))
    one, two = (pad(x.double(), (0, count - len(x))) for x in (own, shape.betas))
    if not torch.allclose(one, two, atol=1e-4):
        say(
            f"{path}: poses of a person of another shape, driven as they are: joints turn and the "
            "root moves as there, bones keep the avatar's lengths, so feet may slide or float"
        )
    return pose, shape
