"""Turning and swaying in the A-pose, with gestures and a face; and held-out poses.

The person turns as on a turntable, feet included. ``t`` are moments (T,) in rounds.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gva_mi.body.gestures import GESTURES, put_hand
from gva_mi.body.pose import JOINTS, Pose
from gva_mi.body.rotations import about, to_matrices, to_rotvecs
from gva_mi.synthetic.motion.actions import POSES

A_POSE = 0.98  # rad, angle of the arms below the T-pose
SIGNED_SIDES = (("left", 1.0), ("right", -1.0))


def novel(count: int, expressions: int, rng: np.random.Generator) -> Pose:
    """Draw ``count`` poses that no video shows: gestures, steps, arms raised and in front.

    Returns:
        ``count`` unrelated frames, root at the origin, facing roughly forward.
    """
    rotations = np.zeros((count, 55, 3))
    names = list(POSES)
    for k in range(count):
        action = POSES[names[k % len(names)]]
        for side, sign in SIGNED_SIDES:
            rotations[k, JOINTS.index(f"{side}_shoulder"), 2] = -sign * A_POSE
            rotations[k, JOINTS.index(f"{side}_elbow"), 1] = -sign * 0.2
        for name, value in action.joints.items():
            rotations[k, JOINTS.index(name)] = np.array(value) * rng.uniform(0.9, 1.1)
        for side, gesture in (("left", action.left), ("right", action.right)):
            put_hand(rotations[k : k + 1], side, GESTURES[gesture].values)
        rotations[k, JOINTS.index("head")] += rng.normal(0, 0.08, 3)
        rotations[k, JOINTS.index("jaw"), 0] = rng.uniform(0, 0.15)
    facing = rng.uniform(-0.9, 0.9, count)
    rotations[:, 0] = to_rotvecs(root_rotations(facing, np.zeros((count, 2))))
    expression = rng.normal(0, 0.5, (count, expressions)) * (np.arange(expressions) < 10)
    return Pose.of_arrays(rotations, np.zeros((count, 3)), expression)


def turning(t: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return rotations (T, 55, 3) and translations (T, 3) of one turn at constant speed."""
    frames = len(t)
    rotations = np.zeros((frames, 55, 3))
    wave = lambda size: slow_wave(t, size, rng)
    direction = rng.choice([-1.0, 1.0])
    for name, size in (
        ("spine1", 0.02), ("spine2", 0.02), ("spine3", 0.02), ("neck", 0.04), ("head", 0.06),
    ):  # fmt: skip
        for axis in range(3):
            rotations[:, JOINTS.index(name), axis] = wave(size)
    for side, sign in SIGNED_SIDES:
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
        put_hand(rotations, side, _blend_between(["rest", *(str(n) for n in names)], at))
    transl = np.stack([wave(0.008), np.zeros(frames), wave(0.008)], axis=1)
    yaw = direction * 2 * np.pi * t
    lean = np.stack([wave(0.015), wave(0.015)], axis=1)
    rotations[:, 0] = to_rotvecs(root_rotations(yaw, lean))
    return rotations, transl


def slow_wave(t: np.ndarray, size: float, rng: np.random.Generator) -> np.ndarray:
    """Draw a slow random function of time (T,)."""
    return sum(
        rng.normal(0, size / k) * np.sin(2 * np.pi * (k * t + rng.uniform())) for k in (1, 2)
    )


def with_face(
    rotations: np.ndarray, transl: np.ndarray, t: np.ndarray, expressions: int,
    rng: np.random.Generator,
) -> Pose:  # fmt: skip
    """Add a face that speaks and looks around, and return the pose."""
    opened = 0.5 - 0.5 * np.cos(2 * np.pi * (6 * t + rng.uniform()))  # six words a round
    speaks = np.clip(0.6 + slow_wave(t, 0.5, rng), 0, 1)
    rotations[:, JOINTS.index("jaw"), 0] = 0.14 * opened * speaks
    gaze = np.stack([slow_wave(t, 0.06, rng), slow_wave(t, 0.15, rng)], axis=1)
    for eye in ("left_eye_smplhf", "right_eye_smplhf"):
        rotations[:, JOINTS.index(eye), :2] = gaze
    expression = np.zeros((len(t), expressions))
    for k in range(min(expressions, 10)):
        expression[:, k] = slow_wave(t, 0.45, rng)
    return Pose.of_arrays(rotations, transl, expression)


def root_rotations(yaw: np.ndarray, lean: np.ndarray) -> np.ndarray:
    """Return matrices (T, 3, 3): a turn by yaw (T,) after small ones (T, 2) about x and z."""
    return about(1, yaw) @ to_matrices(np.stack([lean[:, 0], 0 * yaw, lean[:, 1]], axis=1))


def _blend_between(names: Sequence[str], at: np.ndarray) -> np.ndarray:
    """Blend a cycle of gestures at moments (T,), to :attr:`Gesture.values` (T, 14).

    Gesture k is held from moment k on for a third of a unit.
    """
    keys = np.stack([GESTURES[name].values for name in names])
    index = np.floor(at).astype(int)
    t = np.clip((at - index - 0.35) / 0.65, 0, 1)
    t = (t * t * (3 - 2 * t))[:, None]
    return (1 - t) * keys[index % len(keys)] + t * keys[(index + 1) % len(keys)]
