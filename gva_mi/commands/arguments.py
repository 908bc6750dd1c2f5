"""Arguments that several commands have, and what they mean."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeVar

from tyro.conf import FlagCreatePairsOff, arg

from gva_mi.body.smplx import BodyModel
from gva_mi.check.glance import glance
from gva_mi.console import say
from gva_mi.data.video import REFINED_POSES, Video, best_poses

T = TypeVar("T")
Flat = Annotated[T, arg(name="")]  # options without a prefix on the command line
Switch = Annotated[bool, FlagCreatePairsOff]  # off unless given, so that there is no --no-... flag


def poses_of(subject: Path, given: Path | None = None) -> Path:
    """The file that ``--poses`` names; without it the refined poses, else those of stage 1.

    Poses that were never refined are no error, but a line says so.
    """
    poses = given or best_poses(subject)
    if given is None and poses.name != REFINED_POSES:
        say(f"{subject}: no {REFINED_POSES}, the stage-1 poses are used as they are")
    return poses


def say_doubt(video: Video, model: BodyModel) -> None:
    """Say that the body does not stand where the masks are, before work that would be in vain."""
    if doubt := glance(video, model):
        say(doubt)
