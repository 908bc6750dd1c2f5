"""The steps from a video to an avatar, as functions; the commands of ``gva-mi`` call the same ones.

Example:
    From a video to a video of the avatar from all sides; each step takes seconds to minutes.

    >>> from gva_mi.app import evaluate, fit, prepare, refine, render
    >>> prepare("video.mp4", "me/subject")  # doctest: +SKIP
    >>> refine("me/subject")  # doctest: +SKIP
    >>> fit("me/subject", "me/run")  # doctest: +SKIP
    >>> evaluate("me/run", "me/subject")  # doctest: +SKIP
    >>> render("me/run", "me/turntable", video=True)  # doctest: +SKIP

    ``avatar("video.mp4", "me")`` does the same, and can be resumed.

Each step reads folders and writes a folder or files. It checks its input before any work, locks
what it writes, prints what it found, and replaces nothing unless asked to. Options are dataclasses.
Source: ``refine`` is Sec. 4.2 of the paper, ``fit`` Sec. 4.1, 4.3 and 4.4; the other steps are
ours.

============  ======================================================================
``steps``     one function for each step up to the evaluation
``driving``   ``render``, and what drives an avatar
``scenes``    an avatar's motion in a Mitsuba scene
``pipeline``  all steps on a video (``avatar``), or on a synthetic subject (``demo``)
============  ======================================================================
"""

from gva_mi.app.driving import render
from gva_mi.app.pipeline import AvatarEffort, DemoOptions, avatar, demo
from gva_mi.app.steps import check, evaluate, fit, prepare, refine, track

__all__ = [
    "AvatarEffort", "DemoOptions", "avatar", "check", "demo", "evaluate", "fit", "prepare",
    "refine", "render", "track",
]  # fmt: skip
