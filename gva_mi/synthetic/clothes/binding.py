"""Bind a garment's vertices to the body's: sparse rows of weights that sum to 1.

    follow_nearest    weights ~ exp( -distance² / 2 smooth² ), for clothes and hair
    follow_joint      the mean of the vertices that a joint moves most, for stiff things
    hang_from_hips    a skirt follows the nearest vertices at its waist and both thighs below it:

        thighs   t = REACH · smoothstep(distance below the hips)
        left     s = smoothstep(x / half the body's width)
        weights  (1 - t) nearest,  t s of the left thigh's mean,  t (1 - s) of the right one's

With nearest vertices alone, a skirt would tear in two between the legs.
All functions return (N, V) for N points and V vertices of the body.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from gva_mi.body.pose import JOINTS
from gva_mi.synthetic.clothes.level_sets import smoothstep
from gva_mi.synthetic.rest_body import RestBody

if TYPE_CHECKING:
    from scipy.sparse import csr_array

NEIGHBOURS = 24  # vertices of the body that one vertex of a garment follows
GROUP = 200  # vertices of the body whose mean represents a joint
REACH = 0.9  # weight of the thighs at a skirt's hem
WAIST, SPREAD = -0.02, 0.08  # m below the hips where that begins; smoothing of the neighbours
BETWEEN = 0.75  # of the hips' half width: beyond it, a skirt follows one thigh alone


def follow_nearest(points: np.ndarray, vertices: np.ndarray, smooth: float) -> csr_array:
    """Bind points (N, 3) to the nearest vertices (V, 3), weighted over ``smooth`` metres."""
    from scipy.sparse import csr_array
    from scipy.spatial import cKDTree

    distance, index = cKDTree(vertices).query(points, k=NEIGHBOURS, workers=-1)
    share = np.exp(-(distance**2 - distance[:, :1] ** 2) / (2 * smooth**2))
    share /= share.sum(1, keepdims=True)
    rows = np.repeat(np.arange(len(points)), NEIGHBOURS)
    return csr_array((share.ravel(), (rows, index.ravel())), shape=(len(points), len(vertices)))


def follow_joint(points: np.ndarray, weights: np.ndarray, joint: str) -> csr_array:
    """Bind points (N, 3) to one joint, given the skinning weights (V, 55) of the body."""
    return _follow_means(np.ones((len(points), 1)), weights, joint)


def hang_from_hips(points: np.ndarray, rest: RestBody) -> csr_array:
    """Bind the points (N, 3) of a skirt to hips and thighs."""
    from scipy.sparse import diags_array

    hip, knee = rest.joints["left_hip"], rest.joints["left_knee"]
    middle = rest.joints["pelvis"][0]
    half = 2 * BETWEEN * abs(hip[0] - middle)
    thighs = REACH * smoothstep(hip[1] - points[:, 1], WAIST, 0.75 * (hip[1] - knee[1]))
    left = smoothstep(points[:, 0] - middle, -half, half)
    shares = np.stack([thighs * left, thighs * (1 - left)], axis=1)
    legs = _follow_means(shares, rest.weights, "left_hip", "right_hip")
    return (diags_array(1 - thighs) @ follow_nearest(points, rest.vertices, SPREAD) + legs).tocsr()


def _follow_means(shares: np.ndarray, weights: np.ndarray, *joints: str) -> csr_array:
    """Spread shares (N, G) of G joints over the vertices that each joint moves most."""
    from scipy.sparse import csr_array

    groups = [np.argsort(-weights[:, JOINTS.index(j)], kind="stable")[:GROUP] for j in joints]
    rows = np.repeat(np.arange(len(groups)), GROUP)
    entries = (np.full(len(rows), 1 / GROUP), (rows, np.concatenate(groups)))
    return csr_array(shares) @ csr_array(entries, shape=(len(groups), len(weights)))
