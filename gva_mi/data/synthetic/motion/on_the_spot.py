"""Motions on the spot, as on a turntable: the feet go round with the person."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from gva_mi.body.gestures import GESTURES, put_hand
from gva_mi.body.pose import JOINTS, Pose
from gva_mi.data.synthetic.motion.actions import ACTIONS, POSES, act
from gva_mi.data.synthetic.motion.turning import A_POSE, to_pose, turned, turning, with_face


def turn(t: np.ndarray, expressions: int, rng: np.random.Generator) -> Pose:
    """One full turn in A-pose, slightly swaying, while hands and face go through gestures.

    Args:
        t: moments (T,), in rounds.
        expressions: width of the expression.
        rng: for sway and gestures; the same numbers are drawn for all ``t``.

    Returns:
        T frames, root at the origin.
    """
    rotations, transl = turning(t, rng)
    return with_face(rotations, transl, t, expressions, rng)


def everyday(t: np.ndarray, expressions: int, rng: np.random.Generator) -> Pose:
    """The turn, interrupted by a squat, steps, and what arms do in front of the body.

    Args, Returns: as of :func:`turn`.
    """
    rotations, transl = turning(t, rng)
    act(rotations, t, ACTIONS, rng)
    return with_face(rotations, transl, t, expressions, rng)


def novel(count: int, expressions: int, rng: np.random.Generator) -> Pose:
    """Poses the video does not show: gestures, steps, arms raised and in front of the body.

    Args:
        count: how many.
        expressions: width of the expression.
        rng: for variation and the facing directions.

    Returns:
        ``count`` frames, root at the origin; unlike a video they do not follow each other.
    """
    rotations = np.zeros((count, 55, 3))
    names = list(POSES)
    for k in range(count):
        action = POSES[names[k % len(names)]]
        for side, sign in (("left", 1.0), ("right", -1.0)):
            rotations[k, JOINTS.index(f"{side}_shoulder"), 2] = -sign * A_POSE
            rotations[k, JOINTS.index(f"{side}_elbow"), 1] = -sign * 0.2
        for name, value in action.joints.items():
            rotations[k, JOINTS.index(name)] = np.array(value) * rng.uniform(0.9, 1.1)
        for side, gesture in (("left", action.left), ("right", action.right)):
            put_hand(rotations[k : k + 1], side, GESTURES[gesture].values)
        rotations[k, JOINTS.index("head")] += rng.normal(0, 0.08, 3)
        rotations[k, JOINTS.index("jaw"), 0] = rng.uniform(0, 0.15)
    facing = rng.uniform(-0.9, 0.9, count)
    rotations[:, 0] = turned(facing, np.zeros((count, 2)))
    expression = rng.normal(0, 0.5, (count, expressions)) * (np.arange(expressions) < 10)
    return to_pose(rotations, np.zeros((count, 3)), expression)


ON_THE_SPOT: Mapping[str, Callable[[np.ndarray, int, np.random.Generator], Pose]] = {
    "turn": turn, "everyday": everyday,
}  # fmt: skip
