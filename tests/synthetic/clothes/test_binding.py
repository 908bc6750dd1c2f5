"""Binding of garments: weights that sum to 1, smooth between the legs."""

from types import SimpleNamespace

import numpy as np
import pytest

from gva_mi.body.pose import JOINTS
from gva_mi.synthetic.clothes.dressing import follow_joint, follow_nearest, hang_from_hips

HIP, KNEE = np.array([0.1, 0.9, 0.0]), np.array([0.1, 0.5, 0.0])
PLACES = {
    "pelvis": np.array([0.0, 0.95, 0.0]), "left_hip": HIP, "right_hip": HIP * [-1, 1, 1],
    "left_knee": KNEE, "right_knee": KNEE * [-1, 1, 1],
}  # fmt: skip


@pytest.fixture(scope="module")
def legs():
    """A hip and two thighs made of points, as a rest body."""
    random = np.random.default_rng(0)
    vertices, weights = np.zeros((3, 400, 3)), np.zeros((3, 400, 55))
    boxes = (("pelvis", 0, 0.95, 0.12), ("left_hip", 0.1, 0.7, 0.2), ("right_hip", -0.1, 0.7, 0.2))
    for k, (joint, x, y, tall) in enumerate(boxes):
        vertices[k] = [x, y, 0] + random.uniform(-1, 1, (400, 3)) * [0.08, tall, 0.08]
        weights[k, :, JOINTS.index(joint)] = 1
    return SimpleNamespace(
        vertices=vertices.reshape(-1, 3), weights=weights.reshape(-1, 55), joints=PLACES
    )


@pytest.fixture(scope="module")
def skirt():
    angle, height = np.meshgrid(np.linspace(0, 2 * np.pi, 73), np.linspace(0.5, 1.0, 30))
    radius = 0.2 + 0.3 * (1.0 - height)
    ring = [radius * np.cos(angle), height, radius * np.sin(angle)]
    return np.stack(ring, axis=-1)  # (30, 73, 3)


def test_weights_sum_to_one(legs, skirt):
    vertices, weights = legs.vertices, legs.weights
    points = skirt.reshape(-1, 3)
    for bound in (
        follow_nearest(points, vertices, 0.03),
        follow_joint(points, weights, "head"),
        hang_from_hips(points, legs),
    ):  # fmt: skip
        assert bound.shape == (len(points), len(vertices))
        assert np.allclose(bound.sum(1), 1) and bound.min() >= 0


def test_legs_that_part_do_not_tear_a_skirt(legs, skirt):
    vertices, weights = legs.vertices, legs.weights
    apart = vertices.copy()
    for side, way in (("left_hip", 0.15), ("right_hip", -0.15)):
        apart[weights[:, JOINTS.index(side)] == 1, 2] += way
    stretch = {}
    for name, bound in (
        ("hung", hang_from_hips(skirt.reshape(-1, 3), legs)),
        ("near", follow_nearest(skirt.reshape(-1, 3), vertices, 0.025)),
    ):
        moved = skirt + (bound @ (apart - vertices)).reshape(skirt.shape)
        hem, rest = (np.linalg.norm(np.diff(p[0], axis=0), axis=1) for p in (moved, skirt))
        stretch[name] = (hem / rest).max()
    assert stretch["hung"] < 2 and stretch["hung"] < 0.5 * stretch["near"]
