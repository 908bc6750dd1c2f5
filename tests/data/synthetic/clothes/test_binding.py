"""How garments follow the body: shares, smooth between the legs."""

import numpy as np
import pytest

from gva_mi.body.pose import JOINTS
from gva_mi.data.synthetic.clothes import binding

HIP, KNEE = np.array([0.1, 0.9, 0.0]), np.array([0.1, 0.5, 0.0])
PLACES = {
    "pelvis": np.array([0.0, 0.95, 0.0]), "left_hip": HIP, "right_hip": HIP * [-1, 1, 1],
    "left_knee": KNEE, "right_knee": KNEE * [-1, 1, 1],
}  # fmt: skip


@pytest.fixture(scope="module")
def legs():
    """A hip and two thighs made of points: vertices (V, 3), weights (V, 55)."""
    random = np.random.default_rng(0)
    boxes = {
        "pelvis": (0.0, 0.95, 0.12),
        "left_hip": (0.1, 0.7, 0.2),
        "right_hip": (-0.1, 0.7, 0.2),
    }
    vertices, weights = [], []
    for joint, (x, y, tall) in boxes.items():
        vertices.append([x, y, 0] + random.uniform(-1, 1, (400, 3)) * [0.08, tall, 0.08])
        owner = np.zeros((400, 55))
        owner[:, JOINTS.index(joint)] = 1
        weights.append(owner)
    return np.concatenate(vertices), np.concatenate(weights)


@pytest.fixture(scope="module")
def skirt():
    angle, height = np.meshgrid(np.linspace(0, 2 * np.pi, 73), np.linspace(0.5, 1.0, 30))
    radius = 0.2 + 0.3 * (1.0 - height)
    ring = [radius * np.cos(angle), height, radius * np.sin(angle)]
    return np.stack(ring, axis=-1)  # (30, 73, 3)


def test_shares_sum_to_one(legs, skirt):
    vertices, weights = legs
    points = skirt.reshape(-1, 3)
    for bound in (
        binding.follow_nearest(points, vertices, 0.03),
        binding.follow_joint(points, weights, "head"),
        binding.hang_from_hips(points, vertices, PLACES, weights),
    ):  # fmt: skip
        assert bound.shape == (len(points), len(vertices))
        assert np.allclose(bound.sum(1), 1) and bound.min() >= 0


def test_near_follows_what_is_near(legs):
    vertices, _ = legs
    bound = binding.follow_nearest(vertices[::7], vertices, 0.002)
    assert np.abs(bound @ vertices - vertices[::7]).max() < 0.01


def test_stiff_things_move_alike(legs):
    vertices, weights = legs
    bound = binding.follow_joint(np.random.default_rng(1).normal(size=(50, 3)), weights, "head")
    moved = bound @ np.random.default_rng(2).normal(size=vertices.shape)
    assert np.allclose(moved, moved[0])


def test_a_skirt_follows_the_waist_above_and_both_thighs_below(legs, skirt):
    vertices, weights = legs
    bound = binding.hang_from_hips(skirt.reshape(-1, 3), vertices, PLACES, weights)
    shares = (bound @ weights)[:, [JOINTS.index(f"{s}_hip") for s in ("left", "right")]]
    left, right = np.moveaxis(shares.reshape(*skirt.shape[:2], 2), -1, 0)
    assert (left + right)[0].min() > 0.85  # the hem
    mirrored = (36 - np.arange(73)) % 72
    assert np.allclose(left[0], right[0, mirrored], atol=0.05)
    assert left[0, 0] > 0.85 and right[0, 36] > 0.8 and abs(left[0, 18] - right[0, 18]) < 0.05


def test_legs_that_part_do_not_tear_a_skirt(legs, skirt):
    vertices, weights = legs
    apart = vertices.copy()
    for side, way in (("left_hip", 0.15), ("right_hip", -0.15)):
        apart[weights[:, JOINTS.index(side)] == 1, 2] += way
    stretch = {}
    for name, bound in (
        ("hung", binding.hang_from_hips(skirt.reshape(-1, 3), vertices, PLACES, weights)),
        ("near", binding.follow_nearest(skirt.reshape(-1, 3), vertices, 0.025)),
    ):
        moved = skirt + (bound @ (apart - vertices)).reshape(skirt.shape)
        hem, rest = (np.linalg.norm(np.diff(p[0], axis=0), axis=1) for p in (moved, skirt))
        stretch[name] = (hem / rest).max()
    assert stretch["hung"] < 2 and stretch["hung"] < 0.5 * stretch["near"]
