"""Motions of a subject: what the video shows, and poses that it does not show.

A motion is a periodic function of the time t in [0, 1), one round of the video. It can be evaluated
at any moments ``t`` (T,), in rounds, such as those just before a frame.

All start from a person who turns and sways in the A-pose as on a turntable, with gestures and a
face. ``touch`` is the same turn with arms or hands on the trunk. Motions with feet on the ground
(``ON_FOOT``: standing, half a turn, walking, dancing) are functions of ``t``, the rotations
(T, 55, 3) of this person, which they change in place, the rest joints (55, 3) and a generator; they
return the path of the pelvis and the feet.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.random import Generator

from gva_mi.body.gestures import GESTURES, put_hand
from gva_mi.body.pose import JOINTS, Pose
from gva_mi.body.rotations import about, to_matrices, to_rotvecs
from gva_mi.synthetic.motion.actions import ACTIONS, GESTURING, POSES, act, touch
from gva_mi.synthetic.motion.footwork import Path, follow, root_rotations

ROUND_SECONDS = 6.0  # s, one round; chosen: a turn at the speed that own_video.md asks for
LAG_TIME_STEP = 0.04  # s, of lagging cloth; chosen: about a frame of a video
FULL_TURN = 2 * np.pi  # rad
A_POSE_ANGLE = 0.98  # rad, of the arms below the T-pose; chosen: arms are free of the trunk
SIGNED_SIDES = (("left", 1.0), ("right", -1.0))


def perform(name: str, t: np.ndarray, joints: np.ndarray, expressions: int, rng: Generator) -> Pose:
    """Evaluate a motion, an option of a subject, at moments t (T,), in rounds.

    All start from a turn in the A-pose, slightly swaying, while hands and face go through gestures.
    Steps depend on the length of the legs of ``joints`` (55, 3), the body at rest, metres. The
    draws of ``rng`` do not depend on t. The frames lie near the origin, at any height above the
    ground.
    """
    rotations, transl = turning(t, rng)
    if name == "everyday":
        act(rotations, t, ACTIONS, rng)
    elif name == "touch":
        touch(rotations, t, rng)
    elif name in ON_FOOT:
        transl = follow(ON_FOOT[name](t, rotations, joints, rng), rotations, t, joints)
    return with_face(rotations, transl, t, expressions, rng)


def times(frames: int) -> np.ndarray:
    """Return the moments of a video's frames (T,), in rounds."""
    return np.arange(frames) / frames


def before(t: np.ndarray, steps: int) -> np.ndarray:
    """Return the moments some steps of ``LAG_TIME_STEP`` seconds earlier."""
    return t - steps * LAG_TIME_STEP / ROUND_SECONDS


def novel(count: int, expressions: int, rng: Generator) -> Pose:
    """Draw ``count`` poses that no video shows: gestures, steps, arms raised and in front.

    Returns:
        ``count`` unrelated frames, root at the origin, facing roughly forward.
    """
    rotations = np.zeros((count, 55, 3))
    names = list(POSES)
    for k in range(count):
        action = POSES[names[k % len(names)]]
        for side, sign in SIGNED_SIDES:
            rotations[k, JOINTS.index(f"{side}_shoulder"), 2] = -sign * A_POSE_ANGLE
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


def turning(t: np.ndarray, rng: Generator) -> tuple[np.ndarray, np.ndarray]:
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
        lower = A_POSE_ANGLE + rng.normal(0, 0.04) + wave(0.06)
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


def slow_wave(t: np.ndarray, size: float, rng: Generator) -> np.ndarray:
    """Draw a slow random function of time (T,)."""
    wave = lambda k: rng.normal(0, size / k) * np.sin(2 * np.pi * (k * t + rng.uniform()))
    return wave(1) + wave(2)


def with_face(
    rotations: np.ndarray, transl: np.ndarray, t: np.ndarray, expressions: int, rng: Generator
) -> Pose:
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


def _blend_between(names: Sequence[str], at: np.ndarray) -> np.ndarray:
    """Blend a cycle of gestures at moments (T,), to :attr:`Gesture.values` (T, 14).

    Gesture k is held from moment k on for a third of a unit.
    """
    keys = np.stack([GESTURES[name].values for name in names])
    index = np.floor(at).astype(int)
    t = np.clip((at - index - 0.35) / 0.65, 0, 1)
    t = (t * t * (3 - 2 * t))[:, None]
    return (1 - t) * keys[index % len(keys)] + t * keys[(index + 1) % len(keys)]


def _still(t: np.ndarray, rotations: np.ndarray, joints: np.ndarray, rng: Generator) -> Path:
    """Stand with fixed feet, sway a little, and gesture."""
    act(rotations, t, GESTURING, rng)
    facing = rng.uniform(-0.12, 0.12)
    sway, turn, lean = _waves(rng, 2), _waves(rng, 1), _waves(rng, 2)
    return Path(
        place=lambda t: 0.012 * sway(t),
        yaw=lambda t: facing + 0.03 * np.tanh(turn(t)[:, 0]),
        low=lambda t: np.full(len(t), 0.004),
        lean=lambda t: 0.015 * lean(t),
        cycles=0,
        apart=1.3,
    )


def _half(t: np.ndarray, rotations: np.ndarray, joints: np.ndarray, rng: Generator) -> Path:
    """Turn half round in small steps, and back again."""
    direction, facing = rng.choice([-1.0, 1.0]), rng.uniform(-0.3, 0.3)
    return Path(
        place=lambda t: np.zeros((len(t), 2)),
        yaw=lambda t: facing + direction * np.pi * np.sin(np.pi * t) ** 2,
        low=lambda t: np.full(len(t), 0.004),
        lean=lambda t: np.zeros((len(t), 2)),
        cycles=5,
    )


def _walk(t: np.ndarray, rotations: np.ndarray, joints: np.ndarray, rng: Generator) -> Path:
    """Walk around an oval of some metres: toward the camera, across its view, and away."""
    direction, start = rng.choice([-1.0, 1.0]), rng.uniform(0, 1)
    radii = np.array([rng.uniform(0.95, 1.15), rng.uniform(0.75, 0.95)])
    angle = lambda t: direction * FULL_TURN * (t + start)
    cycles = 6

    def yaw(t: np.ndarray) -> np.ndarray:  # along the oval, growing with t beyond a round
        a = angle(t)
        ahead = np.arctan2(-radii[0] * np.sin(a), radii[1] * np.cos(a)) + np.pi * (direction < 0)
        turns = -a + np.pi * (direction < 0)  # on a circle: selects among equivalent angles
        return ahead + FULL_TURN * np.round((turns - ahead) / FULL_TURN)

    step = lambda t: FULL_TURN * (cycles * t - 0.3)  # the left foot's stance is centred on 0
    swing = 0.45 * np.sin(step(t))
    lower = 1.22  # rad below the T-pose
    for side, sign in SIGNED_SIDES:
        at = lambda joint, side=side: JOINTS.index(f"{side}_{joint}")
        rotations[:, at("collar")] = 0
        rotations[:, at("collar"), 2] = -sign * 0.1 * lower
        hanging = about(2, np.full(len(swing), -sign * 0.9 * lower))
        sway = to_matrices(0.3 * rotations[:, at("shoulder")] * [0, 1, 0])
        rotations[:, at("shoulder")] = to_rotvecs(about(0, sign * swing) @ hanging @ sway)
        rotations[:, at("elbow"), 1] = -sign * (0.25 + 0.2 * np.maximum(-sign * swing, 0))
    rotations[:, JOINTS.index("spine2"), 1] -= 0.10 * np.sin(step(t))
    return Path(
        place=lambda t: radii * np.stack([np.cos(angle(t)), np.sin(angle(t))], axis=1),
        yaw=lambda t: yaw(t) + 0.06 * np.sin(step(t)),
        low=lambda t: np.full(len(t), 0.005),
        lean=lambda t: np.stack([np.full(len(t), 0.04), -0.04 * np.cos(step(t))], axis=1),
        cycles=cycles,
        apart=0.75,
    )


def _dance(t: np.ndarray, rotations: np.ndarray, joints: np.ndarray, rng: Generator) -> Path:
    """Dance: fast arms, quick wide steps, a twisting and bouncing trunk, while turning once."""
    direction, cycles = rng.choice([-1.0, 1.0]), 8
    beat = lambda t, k=1.0, phase=0.0: np.sin(FULL_TURN * (k * cycles * t + phase))
    for name in ("spine1", "spine2", "spine3"):
        rotations[:, JOINTS.index(name), 1] += 0.13 * beat(t, 0.5, 0.25)
    phases = rng.uniform(0, 1, (2, 3))
    for (side, sign), (a, b, c) in zip(SIGNED_SIDES, phases, strict=True):
        lower = 0.35 + 0.75 * beat(t, 0.5, a)  # arms from the hips to above the shoulders
        ahead, bent = 0.45 + 0.45 * beat(t, 1.0, b), 0.9 + 0.7 * beat(t, 1.0, c)
        at = lambda joint, side=side: JOINTS.index(f"{side}_{joint}")
        rotations[:, at("collar")] = 0
        rotations[:, at("collar"), 2] = -sign * 0.12 * lower
        R = about(1, -sign * ahead) @ about(2, -sign * 0.88 * lower)
        rotations[:, at("shoulder")] = to_rotvecs(R)
        rotations[:, at("elbow")] = 0
        rotations[:, at("elbow"), 1] = -sign * bent
    return Path(
        place=lambda t: np.stack(
            [0.16 * beat(t, 0.5) + 0.03 * beat(t), 0.14 * np.sin(FULL_TURN * t)], axis=1
        ),
        yaw=lambda t: (
            direction * FULL_TURN * t + 0.5 * np.sin(2 * FULL_TURN * t) + 0.15 * beat(t, 0.5)
        ),
        low=lambda t: 0.03 + 0.03 * beat(t, 2.0),
        lean=lambda t: np.stack([0.05 * beat(t, 2.0), 0.10 * beat(t)], axis=1),
        cycles=cycles,
        apart=1.35,
    )


def _waves(rng: Generator, count: int) -> Callable[[np.ndarray], np.ndarray]:
    """Draw ``count`` slow random functions of time, (T,) to (T, count), of unit size."""
    seed = int(rng.integers(2**31))

    def waves(t: np.ndarray) -> np.ndarray:
        own = np.random.default_rng(seed)
        return np.stack([slow_wave(t, 1.0, own) for _ in range(count)], axis=1)

    return waves


ON_FOOT: Mapping[str, Callable[[np.ndarray, np.ndarray, np.ndarray, Generator], Path]] = {
    "still": _still,
    "half": _half,
    "walk": _walk,
    "dance": _dance,
}
ON_TURNTABLE = ("turn", "touch")  # all frames together have one ground
