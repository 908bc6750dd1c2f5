"""A benchmark's figures hang together; times themselves are not tested."""

import json

import numpy as np
import pytest
import torch

from gva_mi.splat import bench as module
from gva_mi.splat import machine
from gva_mi.splat.bench import STAGES, BenchOptions, bench
from gva_mi.splat.scene import person_scene

FEW = BenchOptions(repeats=2, calls=3, most_gaussians=1000, most_pixels=128, no_gsplat=True)


@pytest.fixture(scope="module")
def found():
    return bench(person_scene(np.random.default_rng(0), 300, 64), FEW)


def test_every_stage_is_measured(found):
    assert [stage.name for stage in found.stages] == list(STAGES)
    for stage in found.stages:
        assert 0 < stage.time.least <= stage.time.median
        assert stage.share_bytes > 0
    assert {s.name for s in found.stages if s.share_flops} == {"composite", "composite, adjoint"}


def test_pairs_walked_are_some_of_all(found):
    assert 0 < found.walked <= found.pairs
    assert found.gaussians == 300 and (found.width, found.height) == (64, 64)


def test_growth_is_limited(found):
    sizes = [(g.gaussians, g.pixels) for g in found.growth]
    assert sizes == [(1000, 128), (1000, 128)]
    assert module._sizes(BenchOptions())[-1] == (20_000, 2048)
    assert (1_000_000, 512) in module._sizes(BenchOptions())


def test_stopwatches_are_taken_off(found):
    for owner, name in STAGES.values():
        assert "watched" not in getattr(getattr(owner, name), "__qualname__", "")


def test_a_turned_camera_keeps_its_distance():
    s = person_scene(np.random.default_rng(0), 100, 32).to(torch.float32)
    middle = s.gaussians.means.detach().double().mean(dim=0).numpy()
    far = lambda scene: np.linalg.norm(scene.camera.position - middle)
    assert far(module._turned(s, 0.3)) == pytest.approx(far(s))


def test_limits_are_positive():
    limits = machine.measure(repeats=1)
    assert limits.gflops > 0 and limits.gigabytes > 0 and limits.threads >= 1
    assert machine.resident() >= 0


def test_figures_are_json_and_a_table(found):
    figures = json.loads(json.dumps(found.to_dict()))
    assert figures["gsplat"] is None and len(figures["stages"]) == len(STAGES)
    for stage in STAGES:
        assert stage in found.table()
