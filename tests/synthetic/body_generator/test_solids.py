"""Implicit solids and their surface."""

import numpy as np
import pytest
import trimesh

from gva_mi.synthetic.body_generator.solids import Ball, Cone, Join, Loft, surface

ROUND = {
    "ball": Ball((0.1, 0, 0), (0.3, 0.3, 0.3), (0.4, 0.2, 0.9)),
    "cone": Cone((0.1, 0, 0), (0.1, 0, 0), 0.3, 0.3),
    "loft": Loft(1, [(-1e-6, 0.1, 0, *4 * [0.3]), (1e-6, 0.1, 0, *4 * [0.3])], caps=(0.3, 0.3)),
}


@pytest.mark.parametrize("solid", ROUND.values(), ids=ROUND.keys())
def test_a_round_solid_measures_the_distance_to_its_ball(solid):
    points = np.random.default_rng(0).uniform(-0.6, 0.6, (3, 200))
    exact = np.linalg.norm(points - [[0.1], [0], [0]], axis=0) - 0.3
    np.testing.assert_allclose(solid.distance(points), exact, atol=1e-5)


@pytest.mark.parametrize("solid", [
    Ball((0, 0.1, 0), (0.3, 0.1, 0.2), (0.3, 0.5, -0.4)),
    Cone((-0.2, 0, 0), (0.2, 0.1, 0), 0.1, 0.05),
    Loft(2, [(-0.2, 0, 0, 0.1, 0.2, 0.1, 0.1), (0.2, 0, 0.1, 0.1, 0.1, 0.2, 0.1)], power=3),
])  # fmt: skip
def test_a_solid_lies_in_its_bounds(solid):
    points = np.random.default_rng(1).uniform(-0.5, 0.5, (3, 5000))
    inside = points[:, solid.distance(points) < 0]
    low, high = solid.bounds()
    assert inside.size
    assert (inside.T > low - 1e-6).all() and (inside.T < high + 1e-6).all()


def test_surfaces_are_closed_and_point_outward_at_distance_zero():
    joins = [
        Join(Ball((0, 0, 0), (0.3, 0.3, 0.3)), 0.01),
        Join(Ball((0.3, 0, 0), (0.2, 0.2, 0.2)), 0.01, carve=True),
    ]
    uneven = np.concatenate([np.linspace(-0.5, 0.1, 30), np.linspace(0.1, 0.5, 40)[1:]])
    mesh = trimesh.Trimesh(*surface(joins, [uneven] * 3), process=False)
    assert mesh.is_watertight and mesh.euler_number == 2 and mesh.volume > 0
    body, bite = (join.solid.distance(mesh.vertices.T) for join in joins)
    assert np.abs(np.maximum(body, -bite)).max() < 0.008  # fillet and grid
