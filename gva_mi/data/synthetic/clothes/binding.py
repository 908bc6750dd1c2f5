"""Which vertices of the body a garment's vertices follow, and by what shares: rows that sum to 1.

    nearest vertices   shares ~ exp( -distance² / 2 smooth² ), for clothes and hair
    a joint            the mean of the vertices that it moves most, for what is stiff
    the hips           a skirt follows the nearest vertices at its waist and both thighs below it:

        thighs  t = REACH · smoothstep(how far below the hips)
        left    s = smoothstep(x / half the body's width)
        shares  (1 - t) nearest,  t s of the left thigh's mean,  t (1 - s) of the right one's

The nearest vertices alone would tear a skirt in two where the legs part: beside the middle, every
vertex would follow one leg.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from gva_mi.body.pose import JOINTS
from gva_mi.data.synthetic.clothes.level_sets import smoothstep

if TYPE_CHECKING:
    from scipy.sparse import csr_array

NEIGHBOURS = 24  # vertices of the body that one vertex of a garment follows
GROUP = 200  # vertices of the body whose mean stands for a joint: the head, a thigh
REACH = 0.9  # share of the thighs at a skirt's hem
WAIST, SPREAD = -0.02, 0.08  # m below the hips where that begins; over which neighbours share
BETWEEN = 0.75  # of the hips' half width: beyond it, a skirt follows one thigh alone


def follow_nearest(points: np.ndarray, vertices: np.ndarray, smooth: float) -> csr_array:
    """Follow the nearest vertices of the body.

    Args:
        points: (N, 3) rest pose, metres.
        vertices: (V, 3) of the body.
        smooth: metres over which neighbours share.

    Returns:
        (N, V), rows sum to 1, as of all functions here.
    """
    from scipy.sparse import csr_array
    from scipy.spatial import cKDTree

    distance, index = cKDTree(vertices).query(points, k=NEIGHBOURS, workers=-1)
    share = np.exp(-(distance**2 - distance[:, :1] ** 2) / (2 * smooth**2))
    share /= share.sum(1, keepdims=True)
    rows = np.repeat(np.arange(len(points)), NEIGHBOURS)
    return csr_array((share.ravel(), (rows, index.ravel())), shape=(len(points), len(vertices)))


def follow_joint(points: np.ndarray, weights: np.ndarray, joint: str) -> csr_array:
    """Follow what a joint moves most, all points in the same way: for what is stiff.

    Args:
        points: (N, 3).
        weights: (V, 55) skinning weights of the body.
        joint: by name.
    """
    return _shared(np.ones((len(points), 1)), [_moved_by(joint, weights)], len(weights))


def hang_from_hips(
    points: np.ndarray,
    vertices: np.ndarray,
    joints: Mapping[str, np.ndarray],
    weights: np.ndarray,
) -> csr_array:
    """Hang from the hips between the legs.

    Args:
        points: (N, 3) of a skirt, rest pose, metres.
        vertices: (V, 3) of the body.
        joints: rest positions by name.
        weights: (V, 55) skinning weights of the body.
    """
    from scipy.sparse import diags_array

    hip, knee, middle = joints["left_hip"], joints["left_knee"], joints["pelvis"][0]
    half = 2 * BETWEEN * abs(hip[0] - middle)
    thighs = REACH * smoothstep(hip[1] - points[:, 1], WAIST, 0.75 * (hip[1] - knee[1]))
    left = smoothstep(points[:, 0] - middle, -half, half)
    groups = [_moved_by(joint, weights) for joint in ("left_hip", "right_hip")]
    legs = _shared(np.stack([thighs * left, thighs * (1 - left)], axis=1), groups, len(weights))
    return (diags_array(1 - thighs) @ follow_nearest(points, vertices, SPREAD) + legs).tocsr()


def _moved_by(joint: str, weights: np.ndarray) -> np.ndarray:
    """The vertices that a joint moves most."""
    return np.argsort(-weights[:, JOINTS.index(joint)], kind="stable")[:GROUP]


def _shared(shares: np.ndarray, groups: list[np.ndarray], count: int) -> csr_array:
    """Shares (N, G) of the means of G groups of vertices, as (N, count)."""
    from scipy.sparse import csr_array

    means = csr_array(
        (
            np.full(len(groups) * GROUP, 1 / GROUP),
            (np.repeat(np.arange(len(groups)), GROUP), np.concatenate(groups)),
        ),
        shape=(len(groups), count),
    )
    return csr_array(shares) @ means
