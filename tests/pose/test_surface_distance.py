"""Distances from a surface: known ones of a plane and a sphere, and all triangles of the puppet."""

import numpy as np
import pytest
import trimesh

from gva_mi.pose.errors import surface_distances


@pytest.fixture
def points(rng):
    return rng.uniform(-1, 1, (200, 3))


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def test_a_point_of_the_surface_is_no_distance_away(body, rng):
    vertices, faces = body.v_template.numpy().astype("f8"), body.faces.numpy()
    weights = rng.dirichlet((1, 1, 1), len(faces))
    inside = (vertices[faces] * weights[..., None]).sum(1)
    assert surface_distances(inside, vertices, faces).max() < 2.5e-4


def test_a_shifted_plane_is_as_far_away_as_it_was_shifted(points):
    plane = trimesh.creation.box((10, 10, 0.2)).subdivide().subdivide()
    points[:, 2] = 0.1 + np.abs(points[:, 2])
    found = surface_distances(points, plane.vertices, plane.faces)
    np.testing.assert_allclose(found, points[:, 2] - 0.1, atol=1e-12)


def test_a_larger_sphere_is_as_far_away_as_its_radius_is_larger():
    small, large = (trimesh.creation.icosphere(4, r) for r in (1.0, 1.05))
    found = surface_distances(large.vertices, small.vertices, small.faces)
    np.testing.assert_allclose(found, 0.05, atol=1e-3)


def test_beyond_a_corner_the_corner_is_nearest():
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    points = np.array([[-3.0, -4, 0], [0.5, -2, 0], [0.2, 0.2, 7], [1, 1, 0]])
    found = surface_distances(points, corners, np.array([[0, 1, 2]]))
    np.testing.assert_allclose(found, [5, 2, 7, np.sqrt(0.5)], atol=1e-12)


def test_a_triangle_without_area_counts_as_a_line():
    line = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    found = surface_distances(np.array([[1.5, 3, 4]]), line, np.array([[0, 1, 2]]))
    np.testing.assert_allclose(found, [5.0])


def test_on_the_body_it_is_the_minimum_over_all_triangles(body, rng):
    vertices, faces = body.v_template.numpy().astype("f8"), body.faces.numpy()
    points = vertices[::400] + rng.normal(0, 0.04, vertices[::400].shape)
    triangles = np.tile(vertices[faces], (len(points), 1, 1))
    feet = trimesh.triangles.closest_point(triangles, points.repeat(len(faces), 0))
    apart = np.linalg.norm(feet.reshape(len(points), -1, 3) - points[:, None], axis=2)
    found = surface_distances(points, vertices, faces)
    np.testing.assert_allclose(found, apart.min(1), atol=2.5e-4)
