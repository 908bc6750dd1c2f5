"""The commands of ``gva-mi``: each verb is a function.

::

    synth ──▶ subject/ ──▶ refine ──▶ subject/poses_refined.npz ──▶ fit ──▶ run/ ──▶ evaluate
                                                                            ├──────▶ render
                                                                            ├──────▶ view
                                                                            ├──────▶ export
                                                                            └──────▶ track

``prepare`` makes subject/ from a real video, and ``check`` reports what is wrong with it.
``avatar`` runs all steps on a video, ``demo`` on a synthetic subject. Each command reads a folder,
writes a folder, and can be run alone; no output is replaced without ``--overwrite``. A command
reads its arguments and calls the library: for a step, the function of its name in
:mod:`gva_mi.app`. A new command is a function in a new file, and a line in :data:`VERBS`.

==============  ====================================================================
``avatar``      ``avatar`` and ``demo``: all steps; ``synth`` and ``body``
``prepare``     ``prepare`` and ``motion``
``steps``       ``check``, ``refine``, ``fit``, ``evaluate``, ``score``, ``track``, ``render``
``export``      files for other programs
``view``        the viewer in the browser
``study``       studies over many subjects
``batch``       ``avatar`` for each of many videos, on one machine or a cluster
``gradcheck``   gradient checks, and ``bench``: benchmarks of a checkout
``doctor``      checks the dependencies
``parse``       reads a command's arguments, from its signature
``quick_help``  lets ``--help`` do without torch
==============  ====================================================================
"""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

VERBS = {  # shown by `gva-mi --help`, which imports none of them
    "demo": "run all steps on a synthetic subject: synth, refine, fit, evaluate, report",
    "synth": "make a synthetic subject: a video with masks, normals, poses and ground truth",
    "avatar": "run all steps on a video of one person: prepare, refine, fit, evaluate, report",
    "batch": "run all steps on each of many videos, on this machine or on a cluster",
    "prepare": "make a subject from a video, from an estimator's poses, or from a data set",
    "check": "report everything that is wrong with a subject's folder",
    "refine": "refine poses with normals and masks: stage 2 of the paper, Eq. 8",
    "fit": "fit an avatar to a video: Eq. 9, densification, re-initialisation",
    "evaluate": "measure an avatar on the splits of a subject",
    "score": "score the renders of any method by every usual protocol",
    "track": "fit the poses of a video to its pictures, seen through an avatar",
    "render": "drive an avatar by any poses, seen by any cameras",
    "view": "turn, pose and play an avatar in the browser",
    "export": "write an avatar or its poses for other programs",
    "motion": "make poses that drive an avatar, from a video or a motion of AMASS, AIST++ ...",
    "study": "refine or fit several synthetic subjects and measure the errors",
    "body": "write a body file that needs no licence agreement",
    "gradcheck": "check the gradients of the renderer, of an avatar, or of rendered normals",
    "bench": "run the benchmarks of a checkout",
    "doctor": "check the dependencies, and what needs the missing ones",
}


# Modules of the commands that share one; each other command has the module of its name.
MODULES = dict.fromkeys(("check", "refine", "fit", "evaluate", "score", "track", "render"), "steps")
MODULES |= {
    "demo": "avatar",
    "bench": "gradcheck",
    "synth": "avatar",
    "body": "avatar",
    "motion": "prepare",
}


def load(verb: str) -> Callable[..., None]:
    """Import a verb's module, and no other, and return its function."""
    return getattr(import_module(f"gva_mi.cli.{MODULES.get(verb, verb)}"), verb)
