"""The steps from a video to an avatar, as functions; the commands of ``gva-mi`` call the same ones.

::

    from gva_mi.app import evaluate, fit, prepare, refine, render

    prepare("video.mp4", "me/subject")
    refine("me/subject")
    fit("me/subject", "me/run")
    evaluate("me/run", "me/subject")
    render("me/run", "me/turntable", video=True)

Each step reads folders and writes a folder or files. It checks its input before any work, locks
what it writes, prints what it found, and replaces nothing unless asked to. Options are dataclasses.

* ``steps.py``: one function for each step up to the evaluation;
* ``driving.py``: ``render``, and what drives an avatar;
* ``whole.py``: all steps on a video (``avatar``), or on a synthetic subject (``demo``).
"""

from gva_mi.app.driving import render
from gva_mi.app.steps import check, evaluate, fit, prepare, refine, track
from gva_mi.app.whole import AvatarEffort, DemoOptions, avatar, demo

__all__ = [
    "AvatarEffort", "DemoOptions", "avatar", "check", "demo", "evaluate", "fit", "prepare",
    "refine", "render", "track",
]  # fmt: skip
