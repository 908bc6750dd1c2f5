"""Distances from a body and closed level sets."""

import numpy as np

from gva_mi.synthetic.clothes.level_sets import smax, surface_of

RADIUS = 0.5


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
    import trimesh

    grid, d = sampled
    mesh = surface_of(grid, smax(d - 0.02, -0.1 - grid.y + 0 * d))
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    assert solid.is_watertight and solid.euler_number == 2 and solid.volume > 0
