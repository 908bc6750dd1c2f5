"""Shapes, expressions and pose correctives of the built-in body, as displacement fields.

A direction is the displacement of the skin for one unit of its coefficient, which is a clear but
common deviation among people.

* Shapes stretch bones. Joint j has a linear map D_j; joints move along the tree, and the skin
  follows with its weights:

      dJ_j = dJ_parent(j) + D_parent(j) (J_j − J_parent(j)),    dv = Σ_j w_j (dJ_j + D_j (v − J_j))

* Expressions are sums of Gaussian bumps and their mirror images, except that the jaw rotates about
  its joint and lids slide over the eyeball.
* Correctives compensate the volume loss of linear blend skinning: a vertex between two bones bent
  by φ approaches the joint by the factor cos(φ/2). The skin on the outer side is moved out in
  proportion to 1 − cos φ = − uᵀ (R − I) u for a bone along the unit vector u.
"""

from __future__ import annotations

import numpy as np

from gva_mi.body.body_file import SHAPES
from gva_mi.body.pose import JOINTS, LEFT_HAND, PARENTS
from gva_mi.synthetic.person.level_sets import smoothstep
from tools.body_generator.anatomy import EYE_RADIUS, EYE_SLIT, LID_RADIUS, joint_positions

Strains = dict[str, tuple[float, float, float]]  # joint, of both sides: strain along x, y, z

_TRUNK = ("pelvis", "spine1", "spine2", "spine3")
_HAND = ("wrist", *(n.removeprefix("left_") for n in JOINTS[LEFT_HAND]))
_FOOT = ("ankle", "foot")
_HEAD = ("head", "jaw", "eye_smplhf")
_LID_FOLD = 1.25  # rad over the eye's centre; chosen: beyond it the lids do not move
_LID_SKIN = 0.0008  # metres between the eyeball and a sliding lid; chosen: they never touch


def shapes(vertices: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the directions of SHAPES on skin (V, 3, 10) and joints (55, 3, 10)."""
    every = {_without_side(name) for name in JOINTS}
    all_of = lambda names, *strain: {name: strain for name in names}
    stretches: dict[str, Strains] = {
        "height": all_of(every, 0.04, 0.04, 0.04),
        "weight": all_of(_TRUNK, 0.065, 0, 0.08) | all_of(("hip", "knee"), 0.085, 0, 0.085)
        | all_of(("shoulder", "elbow"), 0, 0.09, 0.09) | all_of(("neck",), 0.06, 0, 0.05)
        | all_of(_HAND, 0, 0.03, 0.03) | all_of(("jaw", "head"), 0.02, 0, 0.01),
        "leg length": all_of(("hip", "knee"), 0, 0.06, 0),
        "arm length": all_of(("shoulder", "elbow"), 0.06, 0, 0),
        "shoulder width": {"collar": (0.10, 0, 0), "spine3": (0.07, 0, 0.02),
                           "spine2": (0.03, 0, 0)},
        "hip width": {"pelvis": (0.09, 0, 0.06), "spine1": (0.03, 0, 0.02), "hip": (0.06, 0, 0.05)},
        "chest": {"spine3": (0.02, 0, 0.05)},
        "belly": {"spine1": (0.03, 0, 0.02)},
        "muscles": {"spine3": (0.05, 0, 0.04), "collar": (0.06, 0.05, 0.05),
                    "shoulder": (0, 0.11, 0.11), "elbow": (0, 0.08, 0.08), "hip": (0.06, 0, 0.06),
                    "knee": (0.06, 0, 0.06), "neck": (0.06, 0, 0.06), "spine1": (-0.02, 0, -0.03)},
        "size of the head": all_of(_HEAD, 0.05, 0.05, 0.05) | all_of(_HAND, 0.03, 0.03, 0.03)
        | all_of(_FOOT, 0.03, 0.03, 0.03),
    }  # fmt: skip
    bumps = {  # centre, widths, displacement
        "weight": ((0, 0.02, 0.10), (0.10, 0.09, 0.06), (0, 0, 0.010)),
        "chest": ((0.075, 0.315, 0.11), (0.050, 0.050, 0.05), (0.002, -0.003, 0.016)),
        "belly": ((0, 0.065, 0.10), (0.09, 0.10, 0.06), (0, -0.003, 0.024)),
    }
    pairs = [_stretched(vertices, weights, stretches[name]) for name in SHAPES]
    fields = np.stack([field for field, _ in pairs], axis=-1)
    for name, bump in bumps.items():
        fields[:, :, SHAPES.index(name)] += _bumps(vertices, [bump])
    return fields, np.stack([moves for _, moves in pairs], axis=-1)


def expressions(vertices: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the directions of EXPRESSIONS (V, 3, 10), which leave the joints."""
    jaw = weights[:, JOINTS.index("jaw"), None]
    corner, wide = (0.024, 0.607, 0.086), (0.011, 0.010, 0.020)
    fields = [
        0.20 * jaw * np.cross((1.0, 0, 0), vertices - joint_positions()[JOINTS.index("jaw")]),
        _bumps(vertices, [(corner, wide, (0.005, 0.0055, -0.002)),
                          ((0.044, 0.632, 0.066), (0.014, 0.012, 0.020), (0.001, 0.0035, 0.002))]),
        _bumps(vertices, [(corner, wide, (0.001, -0.0055, -0.001))]),
        _bumps(vertices, [(corner, wide, (-0.007, 0, 0.003)),
                          ((0, 0.607, 0.10), (0.014, 0.012, 0.020), (0, 0, 0.006))]),
        _bumps(vertices, [((0.030, 0.696, 0.08), (0.020, 0.010, 0.030), (0, 0.0055, 0))]),
        _bumps(vertices, [((0.017, 0.692, 0.086), (0.012, 0.009, 0.03), (-0.003, -0.0045, 0.001))]),
        _blink(vertices, weights),
        _bumps(vertices, [((0.046, 0.612, 0.060), (0.015, 0.016, 0.024), (0.0075, 0, 0.004))]),
        (1 - jaw) * _bumps(vertices, [
            ((0, 0.613, 0.095), (0.017, 0.007, 0.020), (0, 0.0045, 0.001)),
            ((0.010, 0.637, 0.096), (0.008, 0.006, 0.012), (0.001, 0.002, 0)),
        ]),
        _bumps(vertices, [((0, 0.605, 0.090), (0.024, 0.014, 0.024), (0.006, 0, 0))], both=False),
    ]  # fmt: skip
    return np.stack(fields, axis=-1)


def correctives(vertices: np.ndarray, normals: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return pose directions (V, 3, 486) on the entries of R − I."""
    fingers = [f"{finger}{k}" for finger in ("index", "middle", "ring", "pinky") for k in (1, 2, 3)]
    x, y = (1, 0, 0), (0, 1, 0)
    outer = {  # joint: its bone, outer side of the bend, radius of the limb, strength
        "elbow": (x, (0, 0, -1), 0.040, 0.45), "shoulder": (x, (0, 1, 0), 0.055, 0.35),
        "knee": (y, (0, 0, 1), 0.052, 0.45), "hip": (y, (0, 0, -1), 0.085, 0.30),
        "wrist": (x, (0, 1, 0), 0.020, 0.20),
    } | {name: (x, (0, 1, 0), 0.0085, 0.45) for name in fingers}  # fmt: skip
    along, out = (0.745, 0, 0.667), (-0.667, 0, 0.745)  # the thumb lies across and bends inward
    outer |= {f"thumb{k}": (along, out, 0.013, f) for k, f in ((1, 0.90), (2, 0.10), (3, 0.28))}
    J, field = joint_positions(), np.zeros((len(vertices), 3, len(JOINTS) - 1, 3, 3))
    for side, mirror in (("left", (1, 1, 1)), ("right", (-1, 1, 1))):
        for name, (bone, direction, radius, strength) in outer.items():
            j = JOINTS.index(f"{side}_{name}")
            bone, direction = np.multiply(bone, mirror), np.multiply(direction, mirror)
            shared = 4 * weights[:, j] * weights[:, PARENTS[j]]  # 1 where both pull alike
            facing = smoothstep((vertices - J[j]) @ direction / radius + 0.3, 0, 1)
            push = strength * radius * shared * facing
            field[:, :, j - 1] = -(push[:, None] * normals)[..., None, None] * np.outer(bone, bone)
    return field.reshape(len(vertices), 3, -1)


def _blink(vertices: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Close the lids over the fixed eyeball.

    The skin of the lids rotates about the axis from ear to ear through the eyeball's centre, so it
    slides over the ball. The edges meet low; skin farther from them moves less.
    """
    field = np.zeros_like(vertices)
    for name in ("left_eye_smplhf", "right_eye_smplhf"):
        eye = JOINTS.index(name)
        offset = vertices - joint_positions()[eye]
        radius = np.linalg.norm(offset, axis=1)
        height = np.arctan2(offset[:, 1], offset[:, 2])  # of the vertex over the eye's centre
        wide = np.clip(1 - (offset[:, 0] / EYE_SLIT[0]) ** 2, 0, 1)
        edge = np.arctan2(EYE_SLIT[1], EYE_RADIUS) * np.sqrt(wide)  # of the open lids, up or down
        follow = 1 - np.clip((np.abs(height) - edge) / (_LID_FOLD - edge), 0, 1)
        turned = height + np.where(height > 0, -1.75, 0.25) * edge * follow**2
        reach = np.hypot(offset[:, 1], offset[:, 2])
        reach = reach * (1 + follow * (np.maximum(radius, EYE_RADIUS + _LID_SKIN) / radius - 1))
        moved = np.stack([offset[:, 0], reach * np.sin(turned), reach * np.cos(turned)], axis=1)
        free = smoothstep((0.8 - weights[:, eye]) / 0.3, 0, 1)  # not the eyeball
        free *= smoothstep((LID_RADIUS + 0.006 - radius) / 0.005, 0, 1) * (offset[:, 2] > 0)
        field += (moved - offset) * free[:, None]
    return field


def _stretched(
    vertices: np.ndarray, weights: np.ndarray, stretch: Strains
) -> tuple[np.ndarray, np.ndarray]:
    """Return the displacement of skin dv (V, 3) and joints dJ (55, 3) by stretched bones."""
    J = joint_positions()
    strain = np.array([stretch.get(_without_side(name), (0, 0, 0)) for name in JOINTS])
    moves = np.zeros_like(J)
    for j, parent in enumerate(PARENTS[1:], start=1):
        moves[j] = moves[parent] + strain[parent] * (J[j] - J[parent])
    return weights @ (moves - strain * J) + (weights @ strain) * vertices, moves


def _without_side(name: str) -> str:
    return name.removeprefix("left_").removeprefix("right_")


def _bumps(vertices: np.ndarray, bumps: list[tuple], both: bool = True) -> np.ndarray:
    """Sum Gaussians (centre, widths, displacement), each with its mirror image."""
    field = np.zeros_like(vertices)
    for centre, width, move in bumps:
        images = ((1, 1, 1), (-1, 1, 1)) if both and centre[0] else ((1, 1, 1),)
        for image in images:
            q = ((vertices - np.multiply(centre, image)) / width) ** 2
            field += np.exp(-q.sum(1) / 2)[:, None] * np.multiply(move, image)
    return field
