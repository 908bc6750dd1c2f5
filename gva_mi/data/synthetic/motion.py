"""How a subject moves: what the video shows, and poses that it does not show.

A motion is a function of the time t in [0, 1), one round of the video, and is periodic: it can be
asked for any frames, and for the moments just before them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import roma
import torch

from gva_mi.body.gestures import GESTURES, AxisAngle, blend_between, put_hand
from gva_mi.body.pose import JOINTS, LEFT_HAND, RIGHT_HAND, Pose

A_POSE = 0.98  # rad, how far the arms hang down from the T-pose
DURATION = 6.0  # s, one round
STEP = 0.04  # s, between the moments that a lag depends on


@dataclass(frozen=True)
class Action:
    """What a body does beside standing in the A-pose."""

    joints: Mapping[str, AxisAngle]  # rotations in place of the A-pose's, by name
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
POSES: Mapping[str, Action] = {  # that no video holds
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
    "t-pose": Action(
        {"left_shoulder": (0, 0, -0.1), "right_shoulder": (0, 0, 0.1),
         "left_elbow": (0, 0, 0), "right_elbow": (0, 0, 0)}, "three", "fist",
    ),
}  # fmt: skip


def times(frames: int) -> np.ndarray:
    """The moments of a video's frames (T,), in rounds."""
    return np.arange(frames) / frames


def before(t: np.ndarray, steps: int) -> np.ndarray:
    """The moments some steps of ``STEP`` seconds earlier."""
    return t - steps * STEP / DURATION


def turn(t: np.ndarray, expressions: int, rng: np.random.Generator) -> Pose:
    """One full turn in A-pose, slightly swaying, while hands and face go through gestures.

    Args:
        t: moments (T,), in rounds.
        expressions: width of the expression.
        rng: for sway and gestures; the same numbers are drawn for all ``t``.

    Returns:
        T frames, root at the origin.
    """
    rotations, transl = _turning(t, rng)
    return _with_face(rotations, transl, t, expressions, rng)


def everyday(t: np.ndarray, expressions: int, rng: np.random.Generator) -> Pose:
    """The turn, interrupted by a squat, steps, and what arms do in front of the body.

    Args, Returns: as of :func:`turn`.
    """
    rotations, transl = _turning(t, rng)
    names = [str(n) for n in rng.permutation(list(ACTIONS))]
    # Each action rises from the turn and sinks back into it, one after the other.
    share, index = np.modf((t % 1.0) * len(names))
    swell = np.sin(np.pi * share) ** 2
    for k, name in enumerate(names):
        weight = np.where(index == k, swell, 0.0)[:, None]
        action = ACTIONS[name]
        for joint, value in action.joints.items():
            target = np.array(value) * rng.uniform(0.9, 1.1)
            at = JOINTS.index(joint)
            rotations[:, at] += weight * (target - rotations[:, at])
        hands = ((LEFT_HAND, "left", action.left), (RIGHT_HAND, "right", action.right))
        for hand, side, gesture in hands:
            shaped = np.zeros((1, 55, 3))
            put_hand(shaped, side, GESTURES[gesture].values)
            rotations[:, hand] += weight[..., None] * (shaped[:, hand] - rotations[:, hand])
    return _with_face(rotations, transl, t, expressions, rng)


MOTIONS: Mapping[str, Callable[[np.ndarray, int, np.random.Generator], Pose]] = {
    "turn": turn, "everyday": everyday,
}  # fmt: skip


def _turning(t: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Rotations (T, 55, 3) and translations (T, 3) of the turn."""
    frames = len(t)
    rotations = np.zeros((frames, 55, 3))
    wave = lambda size: _wave(t, size, rng)
    direction = rng.choice([-1.0, 1.0])
    for name, size in (
        ("spine1", 0.02), ("spine2", 0.02), ("spine3", 0.02), ("neck", 0.04), ("head", 0.06),
    ):  # fmt: skip
        for axis in range(3):
            rotations[:, JOINTS.index(name), axis] = wave(size)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        of = lambda joint, side=side: JOINTS.index(f"{side}_{joint}")
        lower = A_POSE + rng.normal(0, 0.04) + wave(0.06)
        rotations[:, of("shoulder"), 2] = -sign * 0.88 * lower
        rotations[:, of("collar"), 2] = -sign * 0.12 * lower
        rotations[:, of("shoulder"), 1] = wave(0.05)
        rotations[:, of("elbow"), 1] = -sign * (0.25 + wave(0.1))
        rotations[:, of("elbow"), 0] = wave(0.15)
        rotations[:, of("wrist"), 2] = wave(0.12)
        rotations[:, of("wrist"), 1] = wave(0.12)
        rotations[:, of("hip"), 2] = sign * (0.09 + wave(0.01))
        rotations[:, of("hip"), 0] = wave(0.015)
        rotations[:, of("knee"), 0] = np.abs(wave(0.03))
        rotations[:, of("ankle"), 2] = -sign * 0.06
        names = rng.permutation(["open", "fist", "point", "pinch", "three", "thumb"])
        at = ((t + rng.uniform(0, 0.08)) % 1.0) * (len(names) + 1)
        put_hand(rotations, side, blend_between(["rest", *(str(n) for n in names)], at))
    transl = np.stack([wave(0.008), np.zeros(frames), wave(0.008)], axis=1)
    yaw = direction * 2 * np.pi * t
    rotations[:, 0] = _turned(yaw, np.stack([wave(0.015), wave(0.015)], axis=1))
    return rotations, transl


def _wave(t: np.ndarray, size: float, rng: np.random.Generator) -> np.ndarray:
    """A slow random function of time (T,)."""
    return sum(
        rng.normal(0, size / k) * np.sin(2 * np.pi * (k * t + rng.uniform())) for k in (1, 2)
    )


def _with_face(
    rotations: np.ndarray,
    transl: np.ndarray,
    t: np.ndarray,
    expressions: int,
    rng: np.random.Generator,
) -> Pose:
    """The pose with a face that speaks and looks around."""
    opened = 0.5 - 0.5 * np.cos(2 * np.pi * (6 * t + rng.uniform()))  # six words a round
    speaks = np.clip(0.6 + _wave(t, 0.5, rng), 0, 1)
    rotations[:, JOINTS.index("jaw"), 0] = 0.14 * opened * speaks
    gaze = np.stack([_wave(t, 0.06, rng), _wave(t, 0.15, rng)], axis=1)
    for eye in ("left_eye_smplhf", "right_eye_smplhf"):
        rotations[:, JOINTS.index(eye), :2] = gaze
    expression = np.zeros((len(t), expressions))
    for k in range(min(expressions, 10)):
        expression[:, k] = _wave(t, 0.45, rng)
    return _pose(rotations, transl, expression)


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
    rotations[:, 0] = _turned(facing, np.zeros((count, 2)))
    expression = rng.normal(0, 0.5, (count, expressions)) * (np.arange(expressions) < 10)
    return _pose(rotations, np.zeros((count, 3)), expression)


def _turned(yaw: np.ndarray, lean: np.ndarray) -> np.ndarray:
    """Axis-angle of a turn about y after a small lean about x and z."""
    about = lambda axis, a: torch.from_numpy(np.outer(a, axis))
    leaned = torch.from_numpy(np.stack([lean[:, 0], 0 * yaw, lean[:, 1]], axis=1))
    R = roma.rotvec_to_rotmat(about([0, 1, 0], yaw)) @ roma.rotvec_to_rotmat(leaned)
    return roma.rotmat_to_rotvec(R).numpy()


def _pose(rotations: np.ndarray, transl: np.ndarray, expression: np.ndarray) -> Pose:
    tensor = lambda x: torch.from_numpy(x).float()
    return Pose(tensor(rotations), tensor(transl), tensor(expression))
