"""The smoothest cut is the minimum cut."""

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import maximum_flow

from gva_mi.matting.cut import smoothest_cut

H, W = 9, 7


def energy(u, odds, price):
    """Eq. 1 of a set of pixels."""
    right, below = price
    edges = (right * np.abs(np.diff(u, axis=1))).sum() + (below * np.abs(np.diff(u, axis=0))).sum()
    return edges - (odds * u).sum()


def least_energy(odds, price):
    """The least energy of any set: a minimum cut between the person and the background."""
    pixels = np.arange(H * W).reshape(H, W)
    person, background = H * W, H * W + 1
    flat = odds.ravel().astype(int)
    edges = (pixels[:, :-1], pixels[:, 1:], price[0]), (pixels[:-1], pixels[1:], price[1])
    a, b, c = (np.concatenate([x.ravel() for x in column]) for column in zip(*edges, strict=True))
    to_all, every = np.full(H * W, person), np.full(H * W, background)
    rows = np.concatenate([a, b, to_all, pixels.ravel()])
    columns = np.concatenate([b, a, pixels.ravel(), every])
    capacity = np.concatenate([c, c, flat.clip(0), (-flat).clip(0)]).astype(np.int32)
    graph = coo_array((capacity, (rows, columns)), shape=(H * W + 2,) * 2).tocsr()
    return maximum_flow(graph, person, background).flow_value - flat.clip(0).sum()


def test_it_is_the_minimum_cut():
    random = np.random.default_rng(0)
    for _ in range(5):
        odds = random.integers(-40, 41, (H, W)).astype(np.float32)
        price = random.integers(0, 30, (H, W - 1)), random.integers(0, 30, (H - 1, W))
        u = smoothest_cut(odds, price, odds > 0, 2000)
        assert energy(u > 0.5, odds, price) == least_energy(odds, price)
