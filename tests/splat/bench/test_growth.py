"""Sizes grow to where the options say; the hard scenes are what they are called."""

import numpy as np
import pytest

from gva_mi.splat.bench.growth import HARD, growing, hard_scenes, measure_growth
from gva_mi.splat.bench.timing import Work, pairs_of, walked_of
from gva_mi.splat.scene import person_scene


def pairs(scene):
    return pairs_of(Work.on(scene).saved())


def test_sizes():
    sizes = list(growing(1_000_000, 2048))
    assert sizes[0] == (1_000, 512) and (1_000_000, 512) in sizes
    assert sizes[-5:] == [(20_000, width) for width in (128, 256, 512, 1024, 2048)]
    assert list(growing(1_000, 128)) == [(1_000, 128), (1_000, 128)]


def test_hard_scenes_are_hard():
    made = [(make(), plain()) for make, plain in hard_scenes(1_000, 128, 0)]
    assert len(made) == len(HARD)
    (huge, plain), (large, _), (wide, _) = made
    tiles = Work.on(huge).saved().layout.tiles
    assert pairs(huge) == pairs(plain) + tiles
    assert pairs(large) > 0.3 * len(large.gaussians) * tiles
    walked = walked_of(Work.on(large).saved())
    assert walked > 0.9 * pairs(large)  # translucent: the lists are walked to their ends
    assert (wide.camera.width, wide.camera.height) == (128, 128)
    (_, full) = list(hard_scenes(10, 4000, 0))[2]
    assert (full().camera.width, full().camera.height) == (1920, 1080)


def test_a_share_compares_times_per_pair():
    grown = measure_growth("a", person_scene(np.random.default_rng(0), 200, 64), 2)
    assert (grown.gaussians, grown.width, grown.height) == (200, 64, 64)
    assert 0 < grown.memory < grown.process
    assert grown.share is None and grown.beside(grown).share == pytest.approx(1)
