"""The segments in which triangles cut one another hold to their laws."""

import numpy as np
import pytest


@pytest.fixture(scope="module")
def cut(scenes):
    """The function; it can be imported once Mitsuba has its variant."""
    from gva_mi_plugins.mesh_normals.intersections import shared_segments

    return shared_segments


def pairs(count=400):
    """Random triangles, some of which cut one another: two arrays (count, 3, 3)."""
    return np.random.default_rng(0).normal(size=(2, count, 3, 3))


def barycentric(x, p):
    """Coordinates (R, 3) of points (R, 3) in triangles (R, 3, 3), and heights over them (R,)."""
    normal = np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    sides = np.stack([p[:, 1] - p[:, 0], p[:, 2] - p[:, 0], normal], axis=2)
    b = np.linalg.solve(sides, (x - p[:, 0])[..., None])[..., 0]
    return np.column_stack([1 - b[:, 0] - b[:, 1], b[:, :2]]), b[:, 2]


def test_segments_lie_in_both_triangles_and_end_on_a_side(cut):
    f, g = pairs()
    yes, start, end = cut(f, g)
    assert 20 < yes.sum() < len(yes)
    for x in (start, end):
        least = []
        for p in (f[yes], g[yes]):
            b, height = barycentric(x, p)
            assert b.min() > -1e-9 and np.abs(height).max() < 1e-9
            least.append(b.min(1))
        assert np.minimum(*least).max() < 1e-9


def test_triangles_cut_one_another_where_an_edge_passes_through_one(cut):
    f, g = pairs()
    passes = np.zeros(len(f), bool)
    for p, other in ((f, g), (g, f)):
        for k in range(3):
            a, b = p[:, k], p[:, (k + 1) % 3]
            high, low = (barycentric(x, other)[1] for x in (a, b))
            x = a + (high / (high - low))[:, None] * (b - a)
            passes |= (high * low < 0) & (barycentric(x, other)[0].min(1) > 0)
    np.testing.assert_array_equal(cut(f, g)[0], passes)


def test_neither_order_nor_orientation_matter(cut):
    f, g = pairs()
    yes, start, end = cut(f, g)
    for p, q in ((g, f), (f[:, ::-1], g), (np.roll(f, 1, axis=1), g)):
        again, *ends = cut(p, q)
        np.testing.assert_array_equal(again, yes)
        same = np.linalg.norm(ends[0] - start, axis=1) < 1e-9
        ends = np.where(same[:, None, None], np.stack(ends, 1), np.stack(ends[::-1], 1))
        np.testing.assert_allclose(ends, np.stack([start, end], 1), atol=1e-9)


def test_what_does_not_reach_or_only_touches_is_no_cut(cut):
    f = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], float)
    apart = f + [0, 0, 1]
    beside = np.array([[[3, 0, -1], [3, 1, 1], [4, 0, 1]]], float)
    standing = np.array([[[0.2, 0.2, 0], [0.4, 0.2, 0], [0.3, 0.3, 1]]], float)
    on_tip = np.array([[[0.2, 0.2, 0], [0.4, 0.2, 1], [0.3, 0.3, 1]]], float)
    for g in (f, apart, beside, standing, on_tip):
        assert not cut(f, g)[0].any()
