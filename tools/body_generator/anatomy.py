"""Anatomy of the built-in body: joint positions, and the solids of its left half.

Metres, T-pose, y up, facing +z, the left hand toward +x, the pelvis at the origin; about 1.77 m
tall. The right half mirrors the left.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gva_mi.body.pose import JOINTS
from tools.body_generator.solids import Ball, Cone, Join, Loft

_MIDDLE = {
    "pelvis": (0, 0, 0), "spine1": (0, 0.105, -0.012), "spine2": (0, 0.225, -0.018),
    "spine3": (0, 0.315, -0.018), "neck": (0, 0.495, -0.022), "head": (0, 0.585, 0.002),
    "jaw": (0, 0.622, 0.014),
}  # fmt: skip
_LEFT = {
    "hip": (0.085, -0.08, 0.0), "knee": (0.098, -0.485, 0.004), "ankle": (0.104, -0.898, -0.03),
    "foot": (0.116, -0.955, 0.085), "collar": (0.055, 0.425, -0.012),
    "shoulder": (0.178, 0.440, -0.014), "elbow": (0.445, 0.436, -0.024),
    "wrist": (0.703, 0.436, -0.008), "eye_smplhf": (0.0322, 0.672, 0.070),
}  # fmt: skip

# Metres, chosen: the proportions of an adult's eye.
EYE = _LEFT["eye_smplhf"]
EYE_RADIUS, LID_RADIUS = 0.0122, 0.0140
EYE_SLIT = (0.0134, 0.0060)  # half width and half height of the opening between the lids


@dataclass(frozen=True)
class Finger:
    """A finger of the left hand, metres."""

    knuckle: tuple[float, float, float]  # the first one, relative to the wrist
    direction: tuple[float, float, float]
    bones: tuple[float, float, float]  # lengths
    base: float  # radius at the knuckle
    tip: float  # radius at the tip


FINGERS = {name: Finger(*of) for name, *of in (
    ("index", (0.098, 0.003, 0.029), (1, -0.02, 0.075), (0.040, 0.024, 0.021), 0.0096, 0.0079),
    ("middle", (0.102, 0.005, 0.007), (1, -0.02, 0.010), (0.044, 0.028, 0.022), 0.0098, 0.0081),
    ("ring", (0.097, 0.003, -0.0145), (1, -0.02, -0.055), (0.041, 0.026, 0.021), 0.0093, 0.0077),
    ("pinky", (0.088, 0.0, -0.034), (1, -0.02, -0.14), (0.032, 0.019, 0.018), 0.0082, 0.0068),
    ("thumb", (0.024, -0.008, 0.027), (0.74, -0.1, 0.66), (0.046, 0.034, 0.025), 0.0125, 0.0092),
)}  # fmt: skip


def joint_positions() -> np.ndarray:
    """Return the joints in the T-pose, (55, 3), in the order of JOINTS."""
    left = dict(_LEFT)
    for finger in FINGERS:
        for k, position in enumerate(finger_chain(finger)[:3], start=1):
            left[f"{finger}{k}"] = position
    places = dict(_MIDDLE)
    for name, position in left.items():
        places[f"left_{name}"] = position
        places[f"right_{name}"] = np.asarray(position) * (-1, 1, 1)
    return np.array([places[name] for name in JOINTS], dtype=np.float64)


def finger_chain(finger: str) -> np.ndarray:
    """Return the three joints and the tip of a finger of the left hand, (4, 3)."""
    of = FINGERS[finger]
    direction = np.asarray(of.direction) / np.linalg.norm(of.direction)
    reach = np.concatenate([[0], np.cumsum(of.bones)])
    return np.asarray(_LEFT["wrist"]) + of.knuckle + reach[:, None] * direction


def left_half() -> list[Join]:
    """Return the solids of x ≥ 0 in the order in which they are joined."""
    return [*_trunk(), *_leg(), *_foot(), *_arm(), *_hand(), *_head(), *_face()]


def _trunk() -> list[Join]:
    # y: centre x, z; half width twice; depth to the back, to the front
    trunk = Loft(1, [
        (-0.130, 0, -0.005, 0.075, 0.075, 0.060, 0.062),
        (-0.070, 0, -0.005, 0.147, 0.147, 0.090, 0.088),
        (-0.010, 0, -0.005, 0.158, 0.158, 0.098, 0.096),
        (0.055, 0, -0.004, 0.149, 0.149, 0.086, 0.096),
        (0.120, 0, -0.006, 0.134, 0.134, 0.076, 0.094),
        (0.180, 0, -0.006, 0.136, 0.136, 0.082, 0.096),
        (0.250, 0, -0.008, 0.148, 0.148, 0.094, 0.104),
        (0.320, 0, -0.010, 0.158, 0.158, 0.102, 0.108),
        (0.380, 0, -0.014, 0.162, 0.162, 0.098, 0.098),
        (0.430, 0, -0.018, 0.150, 0.150, 0.084, 0.078),
        (0.465, 0, -0.022, 0.112, 0.112, 0.066, 0.058),
        (0.490, 0, -0.024, 0.076, 0.076, 0.056, 0.046),
    ], power=2.25, caps=(0.03, 0.02))  # fmt: skip
    return [
        Join(trunk, 0.02),
        Join(Cone((0.030, 0.500, -0.034), (0.150, 0.458, -0.026), 0.036, 0.036), 0.05),  # trapezius
        Join(Ball((0.072, 0.335, 0.058), (0.075, 0.058, 0.046), (0, 0.25, -0.25)), 0.045),  # chest
        Join(Ball((0.085, 0.330, -0.075), (0.070, 0.085, 0.034), (0, -0.3, 0.1)), 0.05),  # blade
        Join(Ball((0.074, -0.055, -0.062), (0.078, 0.078, 0.062)), 0.035),  # buttock
        Join(Cone((0, 0.06, -0.118), (0, 0.36, -0.134), 0.016, 0.02), 0.03, carve=True),  # spine
    ]


def _leg() -> list[Join]:
    leg = Loft(1, [
        (-0.915, 0.104, -0.034, 0.028, 0.028, 0.044, 0.034),
        (-0.890, 0.104, -0.032, 0.029, 0.029, 0.037, 0.034),
        (-0.850, 0.103, -0.030, 0.030, 0.030, 0.034, 0.032),
        (-0.780, 0.102, -0.028, 0.035, 0.036, 0.038, 0.037),
        (-0.700, 0.101, -0.024, 0.046, 0.047, 0.055, 0.043),
        (-0.620, 0.100, -0.018, 0.053, 0.054, 0.066, 0.046),
        (-0.560, 0.099, -0.010, 0.052, 0.053, 0.062, 0.048),
        (-0.500, 0.098, 0.000, 0.049, 0.050, 0.050, 0.052),
        (-0.460, 0.098, 0.004, 0.052, 0.053, 0.051, 0.055),
        (-0.400, 0.097, 0.006, 0.059, 0.060, 0.058, 0.061),
        (-0.300, 0.094, 0.006, 0.069, 0.073, 0.070, 0.074),
        (-0.200, 0.091, 0.003, 0.079, 0.084, 0.082, 0.084),
        (-0.120, 0.088, 0.000, 0.080, 0.088, 0.090, 0.088),
        (-0.040, 0.085, 0.000, 0.076, 0.080, 0.086, 0.082),
    ], caps=(0.02, 0.07))  # fmt: skip
    return [
        Join(leg, 0.03),
        Join(Ball((0.098, -0.474, 0.040), (0.030, 0.034, 0.022)), 0.02),  # kneecap
        Join(Ball((0.080, -0.612, -0.050), (0.026, 0.085, 0.032)), 0.03),  # calf, inner head
        Join(Ball((0.122, -0.600, -0.045), (0.022, 0.080, 0.030)), 0.03),
        Join(Ball((0.131, -0.902, -0.034), (0.010, 0.014, 0.013)), 0.012),  # ankle bones
        Join(Ball((0.076, -0.895, -0.026), (0.010, 0.014, 0.013)), 0.012),
    ]


def _foot() -> list[Join]:
    # z: centre x, y; inner, outer; down to the sole, up to the instep
    foot = Loft(2, [
        (-0.078, 0.103, -0.948, 0.024, 0.024, 0.028, 0.032),
        (-0.050, 0.103, -0.950, 0.030, 0.030, 0.029, 0.046),
        (-0.010, 0.106, -0.950, 0.031, 0.031, 0.028, 0.060),
        (0.030, 0.110, -0.952, 0.032, 0.034, 0.025, 0.046),
        (0.070, 0.114, -0.956, 0.037, 0.040, 0.022, 0.027),
        (0.100, 0.116, -0.960, 0.040, 0.043, 0.018, 0.017),
        (0.122, 0.117, -0.962, 0.036, 0.040, 0.015, 0.012),
    ], power=2.6, caps=(0.018, 0.016))  # fmt: skip
    parts = [Join(foot, 0.03)]
    toes = (  # base x, z; tip x, z; radius
        (0.0905, 0.120, 0.0925, 0.154, 0.0135), (0.1110, 0.122, 0.1125, 0.156, 0.0095),
        (0.1275, 0.118, 0.1285, 0.147, 0.0088), (0.1425, 0.111, 0.1425, 0.136, 0.0083),
        (0.1555, 0.101, 0.1545, 0.123, 0.0080),
    )  # fmt: skip
    for x0, z0, x1, z1, r in toes:
        parts.append(Join(Cone((x0, -0.964, z0), (x1, -0.977 + r, z1), r * 0.95, r), 0.005))
    return parts


def _arm() -> list[Join]:
    # x: centre y, z; down, up; back, front
    arm = Loft(0, [
        (0.150, 0.436, -0.014, 0.060, 0.046, 0.060, 0.056),
        (0.185, 0.438, -0.015, 0.060, 0.050, 0.060, 0.056),
        (0.230, 0.440, -0.017, 0.054, 0.047, 0.055, 0.052),
        (0.300, 0.440, -0.020, 0.046, 0.041, 0.048, 0.047),
        (0.370, 0.438, -0.023, 0.042, 0.038, 0.045, 0.044),
        (0.430, 0.436, -0.024, 0.037, 0.036, 0.041, 0.039),
        (0.470, 0.436, -0.022, 0.038, 0.037, 0.042, 0.041),
        (0.520, 0.436, -0.018, 0.037, 0.036, 0.042, 0.042),
        (0.580, 0.436, -0.014, 0.032, 0.032, 0.037, 0.037),
        (0.650, 0.436, -0.010, 0.025, 0.025, 0.030, 0.030),
        (0.700, 0.436, -0.008, 0.0205, 0.0205, 0.027, 0.027),
    ], caps=(0.03, 0.02))  # fmt: skip
    return [
        Join(arm, 0.035),
        Join(Ball((0.192, 0.450, -0.014), (0.055, 0.042, 0.054), (0, 0, -0.2)), 0.03),  # deltoid
        Join(Ball((0.330, 0.446, 0.004), (0.070, 0.030, 0.030)), 0.025),  # biceps
        Join(Ball((0.444, 0.436, -0.056), (0.018, 0.016, 0.012)), 0.018),  # elbow
    ]


def _hand() -> list[Join]:
    w = np.asarray(_LEFT["wrist"])
    palm = Loft(0, [
        (w[0] - 0.010, 0.436, -0.008, 0.0190, 0.0190, 0.026, 0.026),
        (w[0] + 0.012, 0.435, -0.008, 0.0180, 0.0185, 0.028, 0.028),
        (w[0] + 0.040, 0.434, -0.010, 0.0165, 0.0175, 0.034, 0.036),
        (w[0] + 0.070, 0.434, -0.011, 0.0145, 0.0160, 0.037, 0.042),
        (w[0] + 0.094, 0.435, -0.011, 0.0115, 0.0135, 0.035, 0.044),
    ], power=2.6, caps=(0.01, 0.010))  # fmt: skip
    thenar = Ball(w + (0.036, -0.013, 0.020), (0.034, 0.0145, 0.018), (0, -0.55, 0))
    parts = [
        Join(palm, 0.012),
        Join(thenar, 0.012),
        Join(Cone(w + (0.034, -0.004, 0.022), w + (0.074, 0, 0.030), 0.010, 0.0085), 0.012),  # web
        Join(Ball(w + (0.044, -0.012, -0.028), (0.034, 0.010, 0.014)), 0.010),
    ]
    for finger in FINGERS:
        chain, of = finger_chain(finger), FINGERS[finger]
        radii = np.linspace(of.base, of.tip, 4)
        if finger == "thumb":
            radii[0] = 0.0142
            ends = zip(chain[:-1], chain[1:], radii[:-1], radii[1:], strict=True)
            parts += [Join(Cone(a, b, r, s), 0.008) for a, b, r, s in ends]
            continue
        chain = chain.copy()
        chain[3] -= (chain[3] - chain[2]) * 0.25  # the ball at the tip adds its radius
        knuckle = Ball(chain[0] + (-0.002, 0.004, 0), (0.012, 0.0085, 0.0092))
        parts.append(Join(knuckle, 0.006))
        ends = zip(chain[:-1], chain[1:], radii[:-1], radii[1:], strict=True)
        parts += [Join(Cone(a, b, r, s), 0.0035) for a, b, r, s in ends]
        parts.append(Join(Ball(chain[1], np.full(3, radii[1] * 1.06)), 0.003))  # middle knuckle
    return parts


def _head() -> list[Join]:
    neck = Loft(1, [
        (0.440, 0, -0.026, 0.066, 0.066, 0.060, 0.060),
        (0.490, 0, -0.022, 0.058, 0.058, 0.056, 0.052),
        (0.540, 0, -0.012, 0.054, 0.054, 0.056, 0.050),
        (0.600, 0, -0.004, 0.054, 0.054, 0.060, 0.052),
        (0.650, 0, -0.004, 0.056, 0.056, 0.066, 0.050),
    ])  # fmt: skip
    face = Loft(1, [
        (0.566, 0, 0.040, 0.024, 0.024, 0.030, 0.042),
        (0.580, 0, 0.032, 0.038, 0.038, 0.036, 0.053),
        (0.600, 0, 0.025, 0.049, 0.049, 0.044, 0.059),
        (0.630, 0, 0.020, 0.058, 0.058, 0.050, 0.065),
        (0.660, 0, 0.014, 0.065, 0.065, 0.056, 0.070),
        (0.695, 0, 0.006, 0.070, 0.070, 0.062, 0.080),
        (0.730, 0, 0.000, 0.070, 0.070, 0.066, 0.080),
    ], power=2.2, caps=(0.012, 0.05))  # fmt: skip
    return [
        Join(neck, 0.03),
        Join(Ball((0, 0.706, -0.014), (0.076, 0.088, 0.098), (0.15, 0, 0)), 0.03),  # skull
        Join(face, 0.025),
        Join(Cone((0.030, 0.625, -0.034), (0.022, 0.480, 0.022), 0.020, 0.012), 0.018),
    ]


def _face() -> list[Join]:
    return [
        Join(Ball((0, 0.580, 0.078), (0.020, 0.013, 0.013)), 0.018),  # chin
        Join(Ball((0.043, 0.648, 0.052), (0.019, 0.014, 0.018), (0, 0.6, 0)), 0.026),  # cheekbone
        Join(Ball((0.037, 0.620, 0.054), (0.020, 0.022, 0.020), (0, 0.6, 0)), 0.030),  # cheek
        Join(Cone((0.010, 0.692, 0.085), (0.048, 0.695, 0.066), 0.0075, 0.0060), 0.018),  # brow
        Join(Ball((0.0335, 0.674, 0.098), (0.0225, 0.0140, 0.022)), 0.014, carve=True),  # socket
        Join(Ball(EYE, (LID_RADIUS,) * 3), 0.007),  # lids
        Join(Ball((EYE[0], EYE[1], 0.088), (*EYE_SLIT, 0.030), (0, 0, 0.06)), 0.0012, carve=True),
        Join(Ball(EYE, (EYE_RADIUS,) * 3), 0.0008),  # eyeball
        Join(Cone((0, 0.684, 0.083), (0, 0.642, 0.096), 0.0085, 0.0120), 0.014),  # nose
        Join(Ball((0, 0.640, 0.104), (0.0105, 0.0090, 0.0105)), 0.008),
        Join(Ball((0.0100, 0.6375, 0.0935), (0.0080, 0.0070, 0.0105)), 0.006),  # nostril's wing
        Join(Ball((0.0055, 0.6310, 0.1000), (0.0030, 0.0030, 0.0050)), 0.003, carve=True),
        Join(Ball((0, 0.626, 0.080), (0.017, 0.014, 0.0140)), 0.012),  # below the nose
        Join(Ball((0, 0.610, 0.080), (0.026, 0.022, 0.014)), 0.014),  # muzzle
        Join(Ball((0.006, 0.6125, 0.0905), (0.0200, 0.0062, 0.0078), (0, 0.3, -0.10)), 0.005),
        Join(Ball((0, 0.6020, 0.0890), (0.0190, 0.0065, 0.0082)), 0.005),  # lower lip
        Join(Ball((0, 0.6072, 0.0930), (0.0235, 0.0012, 0.0200)), 0.0012, carve=True),  # mouth
        Join(Ball((0.0735, 0.657, -0.014), (0.0085, 0.0300, 0.0190), (-0.15, -0.50, -0.12)), 0.005),
        Join(Ball((0.0800, 0.660, -0.007), (0.0065, 0.017, 0.01), (-0.15, -0.5, 0)), 0.004, True),
    ]  # fmt: skip
