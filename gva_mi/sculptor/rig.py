"""What makes a surface a body model: skinning weights and the joint regressor."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gva_mi.body.pose import JOINTS
from gva_mi.sculptor.anatomy import Bone, bones, facial_regions, joint_positions

if TYPE_CHECKING:
    import scipy.sparse as sparse

_NEAREST = 90  # vertices that a joint is regressed from
_QUANTUM = 4096  # weights are multiples of 1/4096, so that rows sum to 1 to the bit


def skinning_weights(vertices: np.ndarray, faces: np.ndarray, twin: np.ndarray) -> np.ndarray:
    """Weights (V, 55) as the equilibrium of heat that flows from the bones over the skin.

    Each vertex is held at the temperature of its nearest bone, with strength h = 1 / d² (d:
    distance to that bone), while heat diffuses over the skin; M holds the vertices' areas:

        (L + M h) w_j = M h p_j,    p_j = 1 where bone j is the nearest, else 0

    So the weights are smooth, lie in [0, 1], sum to 1, and pass from bone to bone over about one
    limb's radius.
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

    L, area = laplacian(vertices, faces)
    hold = sparse.diags(area / np.maximum(d, 0.003) ** 2)
    target = np.zeros((n, len(JOINTS)))
    target[np.arange(n), nearest] = 1
    weights = splu((L + hold).tocsc()).solve(hold @ target)
    return _four_strongest((weights + weights[twin][:, _mirrored_joints()]) / 2)


def laplacian(vertices: np.ndarray, faces: np.ndarray) -> tuple[sparse.csr_matrix, np.ndarray]:
    """Cotangent Laplacian (V, V), positive semi-definite, and the area of each vertex (V,)."""
    import scipy.sparse as sparse

    n = len(vertices)
    L, area = sparse.csr_matrix((n, n)), np.zeros(n)
    for k in range(3):
        a, b, c = (faces[:, (k + i) % 3] for i in range(3))
        u, v = vertices[b] - vertices[a], vertices[c] - vertices[a]
        double = np.linalg.norm(np.cross(u, v), axis=1)
        # Held positive, so that temperatures stay between those of the bones.
        half_cot = np.clip((u * v).sum(1) / (2 * double + 1e-12), 0.02, 20)
        edges = sparse.coo_matrix((half_cot, (b, c)), (n, n))
        L = L - edges - edges.T
        area += np.bincount(a, double / 6, n)
    return (L - sparse.diags(np.asarray(L.sum(1)).ravel())).tocsr(), area


def joint_regressor(
    vertices: np.ndarray, directions: np.ndarray, moves: np.ndarray, twin: np.ndarray
) -> np.ndarray:
    """Sparse rows (55, V), summing to 1, that find the joints in the vertices.

    Of all weights on the nearest vertices, the smallest that are exact on the template and, up to a
    cut-off of the ill-conditioned directions, on every shape. Mirror images have mirrored rows.

    Args:
        vertices: (V, 3) template.
        directions: (V, 3, K) shapes.
        moves: (55, 3, K) what each shape does to the joints.
        twin: (V,) the mirror image of each vertex.
    """
    J = joint_positions()
    regressor = np.zeros((len(J), len(vertices)))
    for j, joint in enumerate(J):
        if JOINTS[j].startswith("right_"):
            left = JOINTS.index(JOINTS[j].replace("right_", "left_"))
            regressor[j, twin] = regressor[left]
            continue
        near = np.argsort(((vertices - joint) ** 2).sum(1), kind="stable")[:_NEAREST]
        affine = np.vstack([np.ones(len(near)), 10 * (vertices[near] - joint).T])
        rows = np.vstack([affine, 10 * directions[near].transpose(1, 2, 0).reshape(-1, len(near))])
        goal = np.concatenate([[1], np.zeros(3), 10 * moves[j].ravel()])
        even = np.full(len(near), 1 / len(near))
        w = even + np.linalg.pinv(rows, rcond=1e-4) @ (goal - rows @ even)
        regressor[j, near] = w + np.linalg.pinv(affine) @ (goal[:4] - affine @ w)
        if not JOINTS[j].startswith("left_"):
            regressor[j] = (regressor[j] + regressor[j, twin]) / 2
    return regressor


def _mirrored_joints() -> list[int]:
    """Of each joint, its mirror image."""
    other = {"left": "right", "right": "left"}
    found = []
    for name in JOINTS:
        side, _, rest = name.partition("_")
        found.append(JOINTS.index(f"{other[side]}_{rest}" if side in other else name))
    return found


def _distance(points: np.ndarray, bone: Bone) -> np.ndarray:
    """Distances (V,) of points (V, 3) from a bone's axis, metres."""
    a, ab = bone.start, bone.end - bone.start
    along = np.clip((points - a) @ ab / (ab @ ab), 0, 1)
    return np.linalg.norm(points - a - along[:, None] * ab, axis=1)


def _four_strongest(weights: np.ndarray) -> np.ndarray:
    """The four largest weights of each row (V, 55), in steps of 1/4096, with sum 1."""
    # Lowering all by the fifth keeps four, and without a jump where fourth and fifth change places.
    fifth = -np.partition(-weights, 4, axis=1)[:, 4:5]
    weights = np.maximum(weights - np.maximum(fifth, 0.003), 0)
    steps = np.round(_QUANTUM * weights / weights.sum(1, keepdims=True))
    steps[np.arange(len(steps)), weights.argmax(1)] += _QUANTUM - steps.sum(1)
    return steps / _QUANTUM
