"""Actions: rotations of a few joints in place of the A-pose, with a gesture of each hand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from gva_mi.body.gestures import GESTURES, AxisAngle, put_hand
from gva_mi.body.pose import JOINTS, LEFT_HAND, RIGHT_HAND


@dataclass(frozen=True)
class Action:
    """An action."""

    joints: Mapping[str, AxisAngle]  # rotations that replace the A-pose's, by name
    left: str  # gesture of the left hand
    right: str  # gesture of the right hand


ACTIONS: Mapping[str, Action] = {  # of the everyday video
    "squat": Action(
        {"left_hip": (-0.95, -0.1, 0.18), "left_knee": (1.25, 0, 0), "left_ankle": (-0.4, 0, 0),
         "right_hip": (-0.95, 0.1, -0.18), "right_knee": (1.25, 0, 0), "right_ankle": (-0.4, 0, 0),
         "spine1": (0.25, 0, 0), "left_shoulder": (0, -0.6, -0.7), "right_shoulder": (0, 0.6, 0.7)},
        "rest", "rest",
    ),
    "step left": Action(
        {"left_hip": (-0.45, 0, 0.06), "left_knee": (0.35, 0, 0), "right_hip": (0.2, 0, -0.06),
         "right_knee": (0.2, 0, 0), "right_shoulder": (-0.3, 0, 1.1)}, "rest", "fist",
    ),
    "step right": Action(
        {"right_hip": (-0.45, 0, -0.06), "right_knee": (0.35, 0, 0), "left_hip": (0.2, 0, 0.06),
         "left_knee": (0.2, 0, 0), "left_shoulder": (-0.3, 0, -1.1)}, "four", "rest",
    ),
    "hands together": Action(
        {"left_shoulder": (0.1, -0.55, -0.95), "right_shoulder": (0.1, 0.55, 0.95),
         "left_elbow": (0, -1.35, 0), "right_elbow": (0, 1.35, 0)}, "open", "open",
    ),
    "drink": Action(
        {"right_shoulder": (0, 0.75, 0.85), "right_elbow": (-0.3, 1.9, 0), "head": (-0.12, 0, 0)},
        "rest", "pinch",
    ),
    "reach": Action(
        {"left_shoulder": (0, -0.3, 0.55), "left_elbow": (0, -0.15, 0), "head": (-0.2, 0.25, 0)},
        "open", "rest",
    ),
}  # fmt: skip
POSES: Mapping[str, Action] = {  # held-out poses
    "wave": Action({"right_shoulder": (0, 0, -0.5), "right_elbow": (0, 0.3, -1.5)}, "rest", "open"),
    "point": Action(
        {"left_shoulder": (0, -1.25, -0.15), "left_elbow": (0, -0.1, 0)}, "point", "rest"
    ),
    "arms up": Action(
        {"left_shoulder": (0, 0, 1.0), "right_shoulder": (0, 0, -1.0),
         "left_elbow": (0, 0, 0.3), "right_elbow": (0, 0, -0.3)}, "open", "open",
    ),
    "step": Action(
        {"left_hip": (-0.55, 0, 0.05), "left_knee": (0.45, 0, 0), "right_hip": (0.3, 0, -0.05),
         "right_knee": (0.25, 0, 0), "left_shoulder": (0.5, 0, -1.0),
         "right_shoulder": (-0.5, 0, 1.0)}, "fist", "fist",
    ),
    "arms in front": Action(
        {"left_shoulder": (0, -0.75, -0.75), "right_shoulder": (0, 0.75, 0.75),
         "left_elbow": (0, -1.2, 0), "right_elbow": (0, 1.2, 0)}, "pinch", "two",
    ),
    "lunge": Action(
        {"left_hip": (-1.05, 0, 0.08), "left_knee": (1.0, 0, 0), "right_hip": (0.45, 0, -0.05),
         "right_knee": (0.65, 0, 0), "right_ankle": (0.2, 0, 0), "left_elbow": (0, -1.4, 0),
         "left_shoulder": (0, -0.2, -1.15), "right_shoulder": (0, 0.2, 1.15)}, "fist", "four",
    ),
    "thumbs up": Action(
        {"right_shoulder": (0, 0.6, 1.0), "right_elbow": (-0.9, 1.4, 0)}, "rest", "thumb",
    ),
    "bow": Action(
        {"spine1": (0.2, 0.2, 0), "spine2": (0.2, 0.15, 0), "neck": (0.15, 0, 0),
         "left_shoulder": (-0.2, -0.5, -0.8), "right_shoulder": (0.2, 0, 0.6)}, "three", "open",
    ),
}  # fmt: skip
GESTURING: Mapping[str, Action] = {  # of a standing person: arms and trunk alone
    name: ACTIONS[name] for name in ACTIONS if not any("knee" in j for j in ACTIONS[name].joints)
}


def act(
    rotations: np.ndarray, t: np.ndarray, actions: Mapping[str, Action], rng: Generator
) -> None:
    """Blend actions into rotations (T, 55, 3) at moments (T,), in place.

    Each happens once a round, in random order and with random amplitudes.
    """
    names = [str(n) for n in rng.permutation(list(actions))]
    share, index = np.modf((t % 1.0) * len(names))
    swell = np.sin(np.pi * share) ** 2
    for k, name in enumerate(names):
        weight = np.where(index == k, swell, 0.0)[:, None]
        action = actions[name]
        for joint, value in action.joints.items():
            target = np.array(value) * rng.uniform(0.9, 1.1)
            at = JOINTS.index(joint)
            rotations[:, at] += weight * (target - rotations[:, at])
        hands = ((LEFT_HAND, "left", action.left), (RIGHT_HAND, "right", action.right))
        for hand, side, gesture in hands:
            shaped = np.zeros((1, 55, 3))
            put_hand(shaped, side, GESTURES[gesture].values)
            rotations[:, hand] += weight[..., None] * (shaped[:, hand] - rotations[:, hand])


# Arms on the trunk in all of a video; the right arm mirrors the left one. Chosen by eye.
TOUCHING: Mapping[str, Mapping[str, AxisAngle]] = {
    "sides": {"left_shoulder": (0, 0, -1.28), "left_elbow": (0, -0.15, 0)},
    "hips": {"left_shoulder": (0, 0.25, -0.75), "left_elbow": (0, -0.4, -1.45)},
    "folded": {"left_shoulder": (0.1, -0.45, -1.2), "left_elbow": (0.2, -1.6, 0)},
}


def touch(rotations: np.ndarray, t: np.ndarray, rng: Generator) -> None:
    """Put arms or hands on the trunk in rotations (T, 55, 3) at moments (T,), in place.

    One of ``TOUCHING`` is drawn for the whole video. The arms sway by some degrees, and the hands
    are at rest.
    """
    posture = TOUCHING[str(rng.choice(list(TOUCHING)))]
    sway = 0.04 * np.sin(2 * np.pi * (2 * t[:, None] + rng.uniform(size=2)))
    for k, (side, mirror) in enumerate((("left", (1, 1, 1)), ("right", (1, -1, -1)))):
        for joint, angles in posture.items():
            at = JOINTS.index(joint.replace("left", side))
            rotations[:, at] = np.array(angles) * mirror
            rotations[:, at, 2] += sway[:, k] if "shoulder" in joint else 0
        rotations[:, JOINTS.index(f"{side}_collar")] = (0, 0, -0.12 * mirror[2])
        put_hand(rotations, side, GESTURES["rest"].values)
