"""How a subject moves: what the video shows, and poses that it does not show.

A motion is a function of the time t in [0, 1), one round of the video, and is periodic: it can be
asked for any frames, and for the moments just before them.

==================  ================================================================
``moments``         the times of frames, and those just before
``turning``         what all share: sway, gestures, a face that speaks
``actions``         squats, steps, and what arms do in front of the body
``on_the_spot``     the turn, the everyday video; novel poses
``legs``            a leg that reaches for a point: two bones, in closed form
``footwork``        steps along any path: feet that stand still while they carry
``on_foot``         standing, half a turn, walking, sitting down, dancing
==================  ================================================================
"""

from __future__ import annotations

import numpy as np

from gva_mi.body.pose import Pose
from gva_mi.data.synthetic.motion.moments import before, times
from gva_mi.data.synthetic.motion.on_foot import ON_FOOT
from gva_mi.data.synthetic.motion.on_the_spot import ON_THE_SPOT, everyday, novel, turn

__all__ = ["MOTIONS", "before", "everyday", "novel", "perform", "times", "turn"]

MOTIONS: tuple[str, ...] = (*ON_THE_SPOT, *ON_FOOT)


def perform(
    name: str, t: np.ndarray, joints: np.ndarray, expressions: int, rng: np.random.Generator
) -> Pose:
    """One of ``MOTIONS``.

    Args:
        name: which one.
        t: moments (T,), in rounds.
        joints: (55, 3) of the body at rest, metres: feet that stand still need legs of a length.
        expressions: width of the expression.
        rng: the same numbers are drawn for all ``t``.

    Returns:
        T frames near the origin, at any height above the ground.
    """
    if name in ON_THE_SPOT:
        return ON_THE_SPOT[name](t, expressions, rng)
    return ON_FOOT[name](t, joints, expressions, rng)
