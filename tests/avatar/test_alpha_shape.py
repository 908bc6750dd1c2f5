"""The outer boundary of an alpha shape, against the ball that rolls around it."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from gva_mi.avatar.surface import alpha_shape

ALPHA = 0.04


def shell(count=3000, radius=0.3, noise=0.02, seed=0):
    """Points near a sphere, metres."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3))
    points *= radius / np.linalg.norm(points, axis=1, keepdims=True)
    return points * (1 + noise * rng.normal(size=(count, 1)))


def as_trimesh(surface):
    return trimesh.Trimesh(surface.vertices, surface.faces, process=False)


def test_an_empty_ball_rests_on_every_triangle_from_outside():
    points = shell(noise=0.05)
    surface = alpha_shape(points, ALPHA, smoothing=0)
    corners = surface.vertices[surface.faces]
    mesh = as_trimesh(surface)
    # The ball's centre is where its three corners are ALPHA away, on the side of the normal.
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(a, b)
    square = lambda v: (v**2).sum(1, keepdims=True)
    across = np.cross(square(a) * b - square(b) * a, normal) / (2 * square(normal))
    height = np.sqrt(np.maximum(ALPHA**2 - square(across), 0))
    centres = corners[:, 0] + across + height * mesh.face_normals
    nearest = cKDTree(points).query(centres)[0]
    assert nearest == pytest.approx(np.full(len(nearest), ALPHA), abs=1e-9)


def test_alpha_is_raised_until_the_ball_does_not_reach_the_inside():
    """The ball of 15 mm rolls into a shell whose points are 19 mm apart; one of 40 mm does not."""
    points, whole = shell(noise=0.005), 4 * np.pi * 0.3**2
    torn, closed = (alpha_shape(points, alpha, smoothing=0) for alpha in (0.015, ALPHA))
    assert torn.open_edges() > 100 and torn.areas().sum() < 0.8 * whole
    assert closed.open_edges() == 0 and closed.areas().sum() > whole
    middle = np.zeros((1, 3))
    raised = alpha_shape(points, 0.015, smoothing=0, inside=middle)
    assert raised.volumes().sum() == pytest.approx(closed.volumes().sum(), rel=0.05)
    enough = alpha_shape(points, ALPHA, smoothing=0, inside=middle)
    assert np.array_equal(enough.faces, closed.faces)
