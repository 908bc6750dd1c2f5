"""Clothes: level sets around a body, how they follow it, creases and lags."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
import trimesh

from gva_mi.body.pose import JOINTS, Shape
from gva_mi.synthetic.person.bodies import RestBody
from gva_mi.synthetic.person.dressing import follow_nearest, hang_from_hips
from gva_mi.synthetic.person.garments import shoe
from gva_mi.synthetic.person.level_sets import BodySurface, VoxelGrid, smax, surface_of
from gva_mi.synthetic.person.surface import LAG_STEPS, lag
from gva_mi.synthetic.person.surface import creases as place_creases

RADIUS = 0.5
HIP, KNEE = np.array([0.1, 0.9, 0.0]), np.array([0.1, 0.5, 0.0])
PLACES = {"pelvis": np.array([0.0, 0.95, 0.0]), "left_hip": HIP, "right_hip": HIP * [-1, 1, 1],
    "left_knee": KNEE, "right_knee": KNEE * [-1, 1, 1]}  # fmt: skip


JOINT_POSITIONS = dict(zip(JOINTS, np.random.default_rng(0).normal(0, 0.4, (55, 3)), strict=True))


@pytest.fixture(scope="module")
def surface(ball):
    normals = ball.vertices / np.linalg.norm(ball.vertices, axis=1, keepdims=True)
    return BodySurface(ball.vertices.astype(float), ball.faces, normals.astype(float))


@pytest.fixture(scope="module")
def sampled(surface):
    grid = VoxelGrid.around(np.full(3, -0.6), np.full(3, 0.6), 0.02)
    return grid, surface.sample(grid)


def test_distance_to_a_ball(surface):
    directions = np.random.default_rng(0).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for height in (-0.03, 0.0, 0.02, 0.04):
        distance = surface.distance(directions * (RADIUS + height))
        assert np.abs(distance - height).max() < 0.002


def test_the_sign_is_right_far_from_the_surface(sampled):
    grid, d = sampled
    r = np.sqrt(grid.x**2 + grid.y**2 + grid.z**2)
    off = np.abs(r - RADIUS) > 0.01
    assert (np.sign(d) == np.sign(r - RADIUS))[off].all()


def test_a_level_set_is_closed_and_faces_outwards(sampled):
    grid, d = sampled
    mesh = surface_of(grid, smax(d - 0.02, -0.1 - grid.y + 0 * d))
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert solid.is_watertight and solid.euler_number == 2 and solid.volume > 0


def test_a_thick_sole_is_lower_and_flat(body):
    rest = RestBody.of(body, Shape(torch.zeros(10)))
    flat, thick = (shoe(rest, "left", s) for s in (0, 0.04))
    lowest = [mesh.vertices[:, 1].min() for mesh in (flat, thick)]
    assert abs(lowest[0] - lowest[1] - 0.04) < 0.002  # metres
    sole = thick.vertices[thick.vertices[:, 1] < lowest[1] + 0.001]
    assert np.ptp(sole[:, 2]) > 0.15  # it stands on all its length
    assert trimesh.Trimesh(thick.vertices, thick.faces, process=False).is_watertight


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
        assert np.allclose(bound.sum(1), 1) and bound.min() >= 0
        moved = skirt + (bound @ (apart - vertices)).reshape(skirt.shape)
        hem, rest = (np.linalg.norm(np.diff(p[0], axis=0), axis=1) for p in (moved, skirt))
        stretch[name] = (hem / rest).max()
    assert stretch["hung"] < 2 and stretch["hung"] < 0.5 * stretch["near"]


@pytest.fixture
def creases():
    rng = np.random.default_rng(1)
    points = rng.normal(0, 0.4, (4000, 3))
    return place_creases(points, np.full(4000, 0.005), JOINT_POSITIONS, rng)


def test_a_straight_joint_and_a_twist_have_no_creases(creases):
    for crease in creases:
        assert not crease.displacement(np.zeros(3)).any()
        assert np.abs(crease.displacement(crease.bone * 0.8)).max() < 1e-12


def test_creases_grow_with_the_bend_and_are_deeper_inside(creases):
    crease = next(c for c in creases if c.joint == JOINTS.index("left_elbow"))
    bend = np.cross(crease.bone, [0.3, 0.5, 0.8])
    bend /= np.linalg.norm(bend)
    sizes = [np.abs(crease.displacement(angle * bend)).sum() for angle in (0.2, 0.6, 1.5)]
    assert sizes[0] < sizes[1] < sizes[2]
    inner = crease.around @ np.cross(bend, crease.bone) > 0
    depth = np.abs(crease.displacement(bend)) / np.maximum(np.abs(crease.height), 1e-12)
    assert depth[inner].mean() > 2 * depth[~inner].mean()
    assert np.abs(crease.displacement(1.5 * bend)).max() <= 0.005


def test_loose_ends_lag_behind_motion_and_not_at_rest():
    now = np.random.default_rng(0).normal(size=(50, 3))
    away = np.tile([0.0, 1.0, 0.0], (50, 1))
    slack = np.linspace(0.001, 0.03, 50)
    still = np.broadcast_to(now, (LAG_STEPS, 50, 3))
    assert np.abs(lag(now, still, slack, away)).max() < 1e-12
    steps = np.arange(1, LAG_STEPS + 1)[:, None, None]
    moved = lag(now, now - steps * [0.01, 0, 0], slack, away)
    assert (moved[:, 0] < 0).all() and np.abs(moved[:, 1:]).max() < 1e-12
    assert (np.linalg.norm(moved, axis=1) <= slack).all()
    assert (np.diff(-moved[:, 0]) > 0).all()  # the looser, the farther
