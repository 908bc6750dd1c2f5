"""A ball's surface, and its distance on a grid."""

import numpy as np
import pytest

from gva_mi.synthetic.clothes.level_sets import BodySurface, VoxelGrid


@pytest.fixture(scope="module")
def surface(ball):
    normals = ball.vertices / np.linalg.norm(ball.vertices, axis=1, keepdims=True)
    return BodySurface(ball.vertices.astype(float), ball.faces, normals.astype(float))


@pytest.fixture(scope="module")
def sampled(surface):
    grid = VoxelGrid.around(np.full(3, -0.6), np.full(3, 0.6), 0.02)
    return grid, surface.sample(grid)
