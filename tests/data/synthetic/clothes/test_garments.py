"""Clothes: openings that are hollow."""

import numpy as np

from gva_mi.data.synthetic.clothes import garments
from gva_mi.data.synthetic.clothes.level_sets import surface_of


def test_an_opening_is_dark_and_hollow(sampled):
    grid, d = sampled
    field = garments._with_opening(d, d, grid.y + 0 * d, wall=0.06, depth=0.1)
    mesh = surface_of(grid, field, d)
    assert mesh.vertices[:, 1].max() < 0.03
    inner = np.linalg.norm(mesh.vertices, axis=1) < 0.35
    inner &= mesh.vertices[:, 1] > -0.2
    assert inner.any() and mesh.shade[inner].max() < 0.5 and mesh.shade.max() == 1
