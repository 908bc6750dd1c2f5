"""Skinning weights and joint regressor of the built-in body."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from gva_mi.body.pose import JOINTS, mirrored_name
from tools.body_generator.anatomy import (
    EYE_RADIUS,
    FINGERS,
    LID_RADIUS,
    finger_chain,
    joint_positions,
)

if TYPE_CHECKING:
    import scipy.sparse as sparse

_REGRESSED_FROM = 90  # nearest vertices that regress a joint; chosen: more than shapes to meet
_WEIGHT_STEPS = 4096  # chosen: weights are multiples of 1/4096, so that rows sum to exactly 1
MIRRORED = [JOINTS.index(mirrored_name(name)) for name in JOINTS]  # of each joint


@dataclass(frozen=True)
class Bone:
    """A thick segment that a joint moves."""

    joint: int
    start: np.ndarray  # (3,) metres
    end: np.ndarray  # (3,)
    radius: float  # of the limb around it, metres
    softness: float = 1.0  # larger values blend its region more gradually into the next


def bones() -> list[Bone]:
    """Return the segments that skinning weights spread from, both sides."""
    J = dict(zip(JOINTS, joint_positions(), strict=True))
    found = [
        Bone(JOINTS.index(name), np.array(a, float), np.array(b, float), radius, softness)
        for name, a, b, radius, softness in (
            ("pelvis", (0, -0.06, 0), (0, 0.04, 0), 0.11, 0.6),
            ("spine1", J["spine1"], (0, 0.20, -0.015), 0.11, 0.5),
            ("spine2", J["spine2"], (0, 0.30, -0.018), 0.11, 0.5),
            ("spine3", J["spine3"], (0, 0.43, -0.02), 0.12, 0.6),
            ("neck", J["neck"], J["head"], 0.055, 1.0),
            ("head", (0, 0.64, 0), (0, 0.72, -0.01), 0.078, 1.0),
        )
    ]
    limbs = [
        ("hip", J["left_hip"] - (0, 0.01, 0), J["left_knee"], 0.078),
        ("knee", J["left_knee"], J["left_ankle"], 0.048),
        ("ankle", J["left_ankle"] - (0, 0.04, 0.03), J["left_foot"], 0.034),
        ("foot", J["left_foot"] + (0, 0, 0.008), J["left_foot"] + (0, -0.008, 0.06), 0.022),
        ("collar", J["left_collar"] + (0.025, 0.012, 0), J["left_shoulder"] - (0.03, 0, 0), 0.052),
        ("shoulder", J["left_shoulder"] + (0.012, 0, 0), J["left_elbow"], 0.046),
        ("elbow", J["left_elbow"], J["left_wrist"], 0.036),
    ]  # fmt: skip
    for finger, of in FINGERS.items():
        chain = finger_chain(finger)
        if finger != "thumb":  # the palm: a ray toward each knuckle
            start = 0.8 * J["left_wrist"] + 0.2 * chain[0]
            limbs.append(("wrist", start, chain[0] - (0.006, 0, 0), 0.014))
        limbs += [(f"{finger}{k + 1}", chain[k], chain[k + 1], of.base) for k in range(3)]
    for side, mirror in (("left", (1, 1, 1)), ("right", (-1, 1, 1))):
        for name, a, b, radius in limbs:
            found.append(Bone(JOINTS.index(f"{side}_{name}"), a * mirror, b * mirror, radius))
    return found


def facial_regions(points: np.ndarray) -> list[tuple[int, np.ndarray, float]]:
    """Assign points (V, 3) of the face to jaw, head and eyes.

    Returns:
        (joint, mask (V,), distance); later ones override earlier ones. A smaller distance in
        metres, as if to the joint's bone, holds more firmly.
    """
    x, y, z = points.T
    # The line between the jaws rises from the mouth to the ear.
    line = np.minimum(0.6072 + 0.10 * np.maximum(0.085 - z, 0), 0.6125)
    line = np.where((np.abs(x) < 0.024) & (z > 0.070), 0.6072, line)
    jaw = (y < line) & (y > 0.562 - 0.25 * (z - 0.06)) & (z > 0.022)
    upper = (y > line) & (y < 0.72) & (z > 0.022)  # held as firmly, or the upper lip would follow
    regions = [(JOINTS.index("jaw"), jaw, 0.018), (JOINTS.index("head"), upper, 0.015)]
    for name in ("left_eye_smplhf", "right_eye_smplhf"):
        centre = joint_positions()[JOINTS.index(name)]
        radius = np.where(z > centre[2], np.linalg.norm(points - centre, axis=1), np.inf)
        ball, lids = radius < EYE_RADIUS + 0.0002, radius < LID_RADIUS + 0.003
        regions.append((JOINTS.index("head"), lids & ~ball, 0.003))
        regions.append((JOINTS.index(name), ball, 0.003))
    return regions


def skinning_weights(vertices: np.ndarray, faces: np.ndarray, image: np.ndarray) -> np.ndarray:
    """Return weights (V, 55) as the equilibrium of heat diffusing from the bones over the skin.

    Each vertex is held at the temperature of its nearest bone with strength h = 1 / d² (d: distance
    to that bone) while heat diffuses over the skin; M holds the areas of vertices:

        (L + M h) w_j = M h p_j,    p_j = 1 where bone j is the nearest, else 0

    The weights are smooth, lie in [0, 1], sum to 1, and blend over about the radius of a limb.
    ``image`` (V,) is the mirror image of each vertex.
    """
    import scipy.sparse as sparse
    from scipy.sparse.linalg import splu

    n = len(vertices)
    nearest, best, d = np.zeros(n, int), np.full(n, np.inf), np.zeros(n)
    for bone in bones():
        distance = _distance(vertices, bone)
        closer = distance - bone.radius < best
        nearest[closer], d[closer] = bone.joint, distance[closer] * bone.softness
        best[closer] = (distance - bone.radius)[closer]
    for joint, mask, distance in facial_regions(vertices):
        nearest[mask], d[mask] = joint, distance

    L, area = _laplacian(vertices, faces)
    hold = sparse.diags(area / np.maximum(d, 0.003) ** 2)
    target = np.zeros((n, len(JOINTS)))
    target[np.arange(n), nearest] = 1
    weights = splu((L + hold).tocsc()).solve(hold @ target)
    return _four_strongest((weights + weights[image][:, MIRRORED]) / 2)


def _laplacian(vertices: np.ndarray, faces: np.ndarray) -> tuple[sparse.csr_matrix, np.ndarray]:
    """Return the cotangent Laplacian (V, V), positive semi-definite, and vertex areas (V,)."""
    import scipy.sparse as sparse

    n = len(vertices)
    L, area = sparse.csr_matrix((n, n)), np.zeros(n)
    for k in range(3):
        a, b, c = (faces[:, (k + i) % 3] for i in range(3))
        u, v = vertices[b] - vertices[a], vertices[c] - vertices[a]
        double = np.linalg.norm(np.cross(u, v), axis=1)
        # Positive, so that temperatures stay between the bones'.
        half_cot = np.clip((u * v).sum(1) / (2 * double + 1e-12), 0.02, 20)
        edges = sparse.coo_matrix((half_cot, (b, c)), (n, n))
        L = L - edges - edges.T
        area += np.bincount(a, double / 6, n)
    return (L - sparse.diags(np.asarray(L.sum(1)).ravel())).tocsr(), area


def joint_regressor(
    vertices: np.ndarray, directions: np.ndarray, moves: np.ndarray, image: np.ndarray
) -> np.ndarray:
    """Return sparse rows (55, V) that sum to 1 and regress the joints from the vertices (V, 3).

    They are the smallest weights on the nearest vertices that are exact on the template and, up to
    ill-conditioned directions, on every shape: ``directions`` (V, 3, K) of the vertices, ``moves``
    (55, 3, K) of the joints. Mirror images have mirrored rows; ``image`` (V,) is each vertex's.
    """
    J = joint_positions()
    regressor = np.zeros((len(J), len(vertices)))
    for j, joint in enumerate(J):
        if JOINTS[j].startswith("right_"):
            left = JOINTS.index(JOINTS[j].replace("right_", "left_"))
            regressor[j, image] = regressor[left]
            continue
        near = np.argsort(((vertices - joint) ** 2).sum(1), kind="stable")[:_REGRESSED_FROM]
        affine = np.vstack([np.ones(len(near)), 10 * (vertices[near] - joint).T])
        rows = np.vstack([affine, 10 * directions[near].transpose(1, 2, 0).reshape(-1, len(near))])
        goal = np.concatenate([[1], np.zeros(3), 10 * moves[j].ravel()])
        even = np.full(len(near), 1 / len(near))
        w = even + np.linalg.pinv(rows, rcond=1e-4) @ (goal - rows @ even)
        regressor[j, near] = w + np.linalg.pinv(affine) @ (goal[:4] - affine @ w)
        if not JOINTS[j].startswith("left_"):
            regressor[j] = (regressor[j] + regressor[j, image]) / 2
    return regressor


def _distance(points: np.ndarray, bone: Bone) -> np.ndarray:
    """Return the distances (V,) of points (V, 3) from a bone's axis, metres."""
    a, ab = bone.start, bone.end - bone.start
    along = np.clip((points - a) @ ab / (ab @ ab), 0, 1)
    return np.linalg.norm(points - a - along[:, None] * ab, axis=1)


def _four_strongest(weights: np.ndarray) -> np.ndarray:
    """Keep the four largest weights of each row (V, 55), in steps of 1/4096, with sum 1."""
    # Subtracting the fifth keeps four, without a jump where fourth and fifth change places.
    fifth = -np.partition(-weights, 4, axis=1)[:, 4:5]
    weights = np.maximum(weights - np.maximum(fifth, 0.003), 0)
    steps = np.round(_WEIGHT_STEPS * weights / weights.sum(1, keepdims=True))
    steps[np.arange(len(steps)), weights.argmax(1)] += _WEIGHT_STEPS - steps.sum(1)
    return steps / _WEIGHT_STEPS
