"""Motions of a subject: what the video shows, and poses that it does not show.

A motion is a periodic function of the time t in [0, 1), one round of the video. It can be evaluated
at any moments, such as those just before a frame.

==================  ================================================================
``turning``         what all motions share, and novel poses
``actions``         squats, steps, and gestures with the arms
``footwork``        steps along any path: feet that do not slide, legs that reach for them
``on_foot``         standing, half a turn, walking, sitting down, dancing
==================  ================================================================
"""

from __future__ import annotations

import numpy as np

from gva_mi.body.pose import Pose
from gva_mi.synthetic.motion.actions import ACTIONS, act
from gva_mi.synthetic.motion.footwork import follow
from gva_mi.synthetic.motion.on_foot import ON_FOOT
from gva_mi.synthetic.motion.turning import novel, turning, with_face

__all__ = ["MOTIONS", "before", "novel", "perform", "times"]

MOTIONS: tuple[str, ...] = ("turn", "everyday", *ON_FOOT)
DURATION = 6.0  # s, one round
STEP = 0.04  # s, time step of lagging cloth


def perform(
    name: str, t: np.ndarray, joints: np.ndarray, expressions: int, rng: np.random.Generator
) -> Pose:
    """Evaluate one of ``MOTIONS`` at moments t (T,), in rounds.

    All start from a turn in the A-pose, slightly swaying, while hands and face go through gestures.
    Steps depend on the length of the legs of ``joints`` (55, 3), the body at rest, metres. The
    draws of ``rng`` do not depend on t. The frames lie near the origin, at any height above the
    ground.
    """
    rotations, transl = turning(t, rng)
    if name == "everyday":
        act(rotations, t, ACTIONS, rng)
    elif name in ON_FOOT:
        transl = follow(ON_FOOT[name](t, rotations, joints, rng), rotations, t, joints)
    return with_face(rotations, transl, t, expressions, rng)


def times(frames: int) -> np.ndarray:
    """Return the moments of a video's frames (T,), in rounds."""
    return np.arange(frames) / frames


def before(t: np.ndarray, steps: int) -> np.ndarray:
    """Return the moments some steps of ``STEP`` seconds earlier."""
    return t - steps * STEP / DURATION
