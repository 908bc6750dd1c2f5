"""The commands of ``gva-mi``: each verb is a function in a file of its own.

::

    synth ──▶ subject/ ──▶ refine ──▶ subject/poses_refined.npz ──▶ fit ──▶ run/ ──▶ evaluate
                                                                            ├──────▶ render
                                                                            ├──────▶ view
                                                                            ├──────▶ export
                                                                            └──────▶ track

``prepare`` makes such a subject/ of a real video, and ``check`` says what is wrong with one.
``demo`` runs them all but ``render``, ``view``, ``export`` and ``track``. Each reads a folder,
writes a folder, and can be run alone; no output is replaced unless asked for. A command checks its
arguments, calls the library, and says what came of it. A new command is a new file and a line in
:data:`VERBS`.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

VERBS = {  # and what each does, told by `gva-mi --help` without importing any of them
    "demo": "all of it on a synthetic subject: synth, refine, fit, evaluate, report",
    "synth": "make a synthetic subject: a video, what goes with it, and the truth apart",
    "prepare": "make a subject of a video, masks, and what a pose estimator wrote",
    "check": "say all that is wrong with a subject's folder, in one pass",
    "refine": "refine poses with normals and masks: stage 2 of the paper, Eq. 8",
    "fit": "fit an avatar to a video: Eq. 9, densification, re-initialisation",
    "evaluate": "measure an avatar on the splits of a subject",
    "track": "fit the poses of a video to its pictures, seen through an avatar",
    "render": "drive an avatar by any poses, seen by any cameras",
    "view": "turn, pose and play an avatar in the browser",
    "export": "write an avatar, its poses, or a film of it for other programs",
    "motion": "turn a motion of AMASS, AIST++ or the like into poses that drive an avatar",
    "study": "refine, or fit, several synthetic people, and print how near they come to the truth",
    "body": "write a body file, and a picture of it from all around",
    "gradcheck": "check the gradients of the renderer, of an avatar, or of rendered normals",
    "bench": "run the benchmarks of a checkout",
    "doctor": "say what this machine has, and what is missing for what",
}

RENAMED_VERBS = {"gradcheck-normals": "gradcheck normals"}  # the old name answers with the new one


def load(verb: str) -> Callable[..., None]:
    """The function of a verb; its module is imported now, and no other command's."""
    name = verb.replace("-", "_")
    return getattr(import_module(f"gva_mi.commands.{name}"), name)
