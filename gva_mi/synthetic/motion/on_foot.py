"""Motions with feet on the ground: standing, half a turn, walking, sitting down, dancing.

Each is a function of the moments ``t`` (T,) in rounds, the rotations (T, 55, 3) of a person turning
in the A-pose, which it changes in place, the rest joints (55, 3) and a generator; it returns the
path of the pelvis and the feet.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from gva_mi.body.pose import JOINTS
from gva_mi.body.rotations import about, to_matrices, to_rotvecs
from gva_mi.synthetic.motion.actions import GESTURING, act
from gva_mi.synthetic.motion.footwork import Path
from gva_mi.synthetic.motion.turning import SIGNED_SIDES, slow_wave

CIRCLE = 2 * np.pi


def _still(
    t: np.ndarray, rotations: np.ndarray, joints: np.ndarray, rng: np.random.Generator
) -> Path:
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


def _half(
    t: np.ndarray, rotations: np.ndarray, joints: np.ndarray, rng: np.random.Generator
) -> Path:
    """Turn half round in small steps, and back again."""
    direction, facing = rng.choice([-1.0, 1.0]), rng.uniform(-0.3, 0.3)
    return Path(
        place=lambda t: np.zeros((len(t), 2)),
        yaw=lambda t: facing + direction * np.pi * np.sin(np.pi * t) ** 2,
        low=lambda t: np.full(len(t), 0.004),
        lean=lambda t: np.zeros((len(t), 2)),
        cycles=5,
    )


def _walk(
    t: np.ndarray, rotations: np.ndarray, joints: np.ndarray, rng: np.random.Generator
) -> Path:
    """Walk around an oval of some metres: toward the camera, across its view, and away."""
    direction, start = rng.choice([-1.0, 1.0]), rng.uniform(0, 1)
    radii = np.array([rng.uniform(0.95, 1.15), rng.uniform(0.75, 0.95)])
    angle = lambda t: direction * CIRCLE * (t + start)
    cycles = 6

    def yaw(t: np.ndarray) -> np.ndarray:  # along the oval, growing with t beyond a round
        a = angle(t)
        ahead = np.arctan2(-radii[0] * np.sin(a), radii[1] * np.cos(a)) + np.pi * (direction < 0)
        turns = -a + np.pi * (direction < 0)  # on a circle: selects among equivalent angles
        return ahead + CIRCLE * np.round((turns - ahead) / CIRCLE)

    step = lambda t: CIRCLE * (cycles * t - 0.3)  # the left foot's stance is centred on 0
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


def _sit(
    t: np.ndarray, rotations: np.ndarray, joints: np.ndarray, rng: np.random.Generator
) -> Path:
    """Sit down as on a chair, move the arms there, and stand up again."""
    facing = rng.uniform(-0.9, 0.9)
    leg = np.linalg.norm(joints[JOINTS.index("left_hip")] - joints[JOINTS.index("left_ankle")])

    def down(t: np.ndarray) -> np.ndarray:  # 0 stands, 1 sits
        s = np.clip(1.6 * (0.5 - 0.5 * np.cos(CIRCLE * t)) - 0.15, 0, 1)
        return s * s * (3 - 2 * s)

    bent = down(t)[:, None]
    rotations[:, JOINTS.index("spine1"), 0] += 0.22 * bent[:, 0]
    rotations[:, JOINTS.index("neck"), 0] -= 0.35 * bent[:, 0]
    raise_, beat = _waves(rng, 2)(t), _waves(rng, 2)(3 * t)
    for k, (side, sign) in enumerate(SIGNED_SIDES):
        shoulder, elbow = (JOINTS.index(f"{side}_{name}") for name in ("shoulder", "elbow"))
        ahead = np.stack([0 * t, -sign * (0.9 + 0.25 * raise_[:, k]), -sign * 0.55 + 0 * t], axis=1)
        rotations[:, shoulder] += bent * (ahead - rotations[:, shoulder])
        rotations[:, elbow, 1] -= sign * bent[:, 0] * (0.5 + 0.35 * np.tanh(beat[:, k]))
    forward = np.array([np.sin(facing), np.cos(facing)])
    return Path(
        place=lambda t: -0.26 * leg * down(t)[:, None] * forward,
        yaw=lambda t: np.full(len(t), facing),
        low=lambda t: 0.005 + 0.30 * leg * down(t),
        lean=lambda t: np.stack([0.42 * down(t), np.zeros(len(t))], axis=1),
        cycles=0,
        apart=1.5,
    )


def _dance(
    t: np.ndarray, rotations: np.ndarray, joints: np.ndarray, rng: np.random.Generator
) -> Path:
    """Dance: fast arms, quick wide steps, a twisting and bouncing trunk, while turning once."""
    direction, cycles = rng.choice([-1.0, 1.0]), 8
    beat = lambda t, k=1.0, phase=0.0: np.sin(CIRCLE * (k * cycles * t + phase))
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
            [0.16 * beat(t, 0.5) + 0.03 * beat(t), 0.14 * np.sin(CIRCLE * t)], axis=1
        ),
        yaw=lambda t: direction * CIRCLE * t + 0.5 * np.sin(2 * CIRCLE * t) + 0.15 * beat(t, 0.5),
        low=lambda t: 0.03 + 0.03 * beat(t, 2.0),
        lean=lambda t: np.stack([0.05 * beat(t, 2.0), 0.10 * beat(t)], axis=1),
        cycles=cycles,
        apart=1.35,
    )


ON_FOOT: Mapping[str, Callable[[np.ndarray, np.ndarray, np.ndarray, np.random.Generator], Path]] = {
    "still": _still,
    "half": _half,
    "walk": _walk,
    "sit": _sit,
    "dance": _dance,
}


def _waves(rng: np.random.Generator, count: int) -> Callable[[np.ndarray], np.ndarray]:
    """Draw ``count`` slow random functions of time, (T,) to (T, count), of unit size."""
    seed = int(rng.integers(2**31))

    def waves(t: np.ndarray) -> np.ndarray:
        own = np.random.default_rng(seed)
        return np.stack([slow_wave(t, 1.0, own) for _ in range(count)], axis=1)

    return waves
