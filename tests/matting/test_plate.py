"""Means of what is known around each pixel."""

import numpy as np

from gva_mi.matting.plate import MEAN_SQUARE, Around

H, W = 24, 30


def test_means_are_those_of_the_known_pixels_in_the_square_or_around_the_nearest():
    random = np.random.default_rng(0)
    values = random.random((H, W, 3), dtype=np.float32)
    known = random.random((H, W)) < 0.2
    known[:, W // 2 :] = False
    mean, variance = Around.of(known).moments(values)
    reach = MEAN_SQUARE // 2
    squares = {
        (i, j): values[i - reach : i + reach + 1, j - reach : j + reach + 1][
            known[i - reach : i + reach + 1, j - reach : j + reach + 1]
        ]
        for i in range(reach, H - reach)
        for j in range(reach, W - reach)
    }
    for (i, j), square in squares.items():
        if len(square):
            np.testing.assert_allclose(mean[i, j], square.mean(0), atol=1e-5)
            np.testing.assert_allclose(variance[i, j], square.var(0).sum(), atol=1e-4)
        else:  # that of a pixel whose square has known ones
            assert (np.abs(mean[:, : j + 1] - mean[i, j]).max(2) == 0)[:, :j].any()
    assert any(not len(square) for square in squares.values())


def test_where_nothing_is_known_means_are_zero_and_variances_one():
    mean, variance = Around.of(np.zeros((H, W), bool)).moments(np.ones((H, W, 3), np.float32))
    assert not mean.any() and (variance == 1).all()
