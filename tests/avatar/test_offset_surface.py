"""Offset surfaces are closed, of the right size, and complete."""

import numpy as np
import trimesh

from gva_mi.avatar.surface import SurfaceMesh, offset_surface

ALPHA = 0.03


def ball(radius, center=(0, 0, 0), count=4000):
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    return trimesh.sample.sample_surface(mesh, count, seed=3)[0] + center


def inner(radius):
    mesh = trimesh.creation.icosphere(subdivisions=2, radius=radius)
    return SurfaceMesh(np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int64))


def mesh_of(surface):
    return trimesh.Trimesh(surface.vertices, surface.faces, process=False)


def test_a_ball_comes_back_as_large_as_it_was():
    mesh = mesh_of(offset_surface(ball(0.3), inner(0.25), ALPHA, 10))
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.body_count == 1
    away = np.linalg.norm(mesh.vertices, axis=1) - 0.3
    assert abs(np.median(away)) < 0.002 and np.abs(away).max() < 0.008


def test_a_gap_narrower_than_twice_alpha_is_bridged_and_a_wider_one_is_not():
    small = 0.1
    for gap, pieces in ((0.7 * 2 * ALPHA, 1), (1.4 * 2 * ALPHA, 2)):
        points = np.vstack([ball(0.3), ball(small, (0.3 + small + gap, 0, 0))])
        assert mesh_of(offset_surface(points, inner(0.25), ALPHA, 0)).body_count == pieces


def test_a_thin_plate_beside_the_body_is_kept_with_both_its_sides():
    """Such as the brim of a cap."""
    random = np.random.default_rng(0)
    plate = np.stack([random.uniform(0.28, 0.5, 3000), random.uniform(-0.1, 0.1, 3000)], 1)
    plate = np.column_stack([plate, np.zeros(3000)])
    mesh = mesh_of(offset_surface(np.vstack([ball(0.3), plate]), inner(0.25), ALPHA, 4))
    outside = mesh.vertices[mesh.vertices[:, 0] > 0.36]
    assert np.percentile(np.abs(outside[:, 2]), 95) < 0.008
    normals = mesh.vertex_normals[mesh.vertices[:, 0] > 0.36]
    assert (normals[:, 2] > 0.5).any() and (normals[:, 2] < -0.5).any()
    assert mesh.vertices[:, 0].max() > 0.48
