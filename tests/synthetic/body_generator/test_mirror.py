"""Mirroring half of a surface."""

import gva_mi  # noqa: F401, I001  (first: it chooses the libLLVM)

import numpy as np
import pytest

from gva_mi.synthetic.body_generator.mirror import border_of, onto_border


def sheet(n):
    """Return a flat square of n x n vertices and width 1."""
    y, x = np.mgrid[:n, :n] / (n - 1)
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    quads = np.stack([corner, corner + 1, corner + n + 1, corner + n], axis=1)
    vertices = np.stack([x.ravel(), y.ravel(), np.zeros(n * n)], axis=1)
    return vertices, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def perimeter(points):
    return np.linalg.norm(points - np.roll(points, -1, axis=0), axis=1).sum()


def test_slid_vertices_return_to_their_order():
    fine, fine_faces = sheet(17)
    outline = fine[border_of(fine_faces)]
    vertices, faces = sheet(5)
    loop = border_of(faces)
    assert len(set(loop.tolist())) == len(loop) == 16
    assert perimeter(vertices[loop]) == pytest.approx(4)
    slid = vertices.copy()
    slid[loop[[6, 7]]] = vertices[loop[[7, 6]]]
    slid[loop[3]] += (0.02, -0.03, 0.01)
    assert perimeter(slid[loop]) > 4.1
    back = onto_border(slid, faces, outline)
    assert perimeter(back[loop]) == pytest.approx(4)
    np.testing.assert_allclose(back[loop[[6, 7]]], vertices[loop[[6, 7]]], atol=1e-12)
    inner = np.setdiff1d(np.arange(25), loop)
    np.testing.assert_array_equal(back[inner], slid[inner])
