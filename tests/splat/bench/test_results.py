"""A benchmark's figures hang together; times themselves are not tested."""

import json

import numpy as np
import pytest

from gva_mi.splat.bench import BenchOptions, bench
from gva_mi.splat.bench.growth import HARD
from gva_mi.splat.bench.stages import STAGES
from gva_mi.splat.scene import person_scene

FEW = BenchOptions(repeats=2, calls=3, most_gaussians=1000, most_pixels=128, no_gsplat=True)


@pytest.fixture(scope="module")
def found():
    steps = []
    scene = person_scene(np.random.default_rng(0), 300, 64)
    found = bench(scene, FEW, lambda done, total: steps.append((done, total)))
    assert [done for done, _ in steps] == list(range(1, steps[0][1] + 1))
    return found


def test_pairs_walked_are_some_of_all(found):
    assert 0 < found.walked <= found.pairs
    assert found.gaussians == 300 and (found.width, found.height) == (64, 64)


def test_every_hard_scene_has_a_share_of_its_plain_one(found):
    assert [(g.gaussians, g.width) for g in found.growth] == [(1000, 128), (1000, 128)]
    shares = {g.name: g.share for g in found.hard if g.share is not None}
    assert tuple(shares) == HARD and all(share > 0 for share in shares.values())
    assert len(found.hard) == 2 * len(HARD)


def test_figures_are_json_and_a_table(found):
    figures = json.loads(json.dumps(found.to_dict()))
    assert figures["gsplat"] is None and len(figures["stages"]) == len(STAGES)
    for name in (*STAGES, *HARD, "another pose", "a new pose at every call"):
        assert name in found.table()


def test_options_that_measure_nothing_are_refused():
    for name in ("repeats", "calls", "most_gaussians", "most_pixels"):
        with pytest.raises(ValueError, match=f"{name} must be from 1 to .*, got 0"):
            BenchOptions(**{name: 0})
