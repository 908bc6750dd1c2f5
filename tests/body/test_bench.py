import gva_mi  # noqa: F401, I001  (first: it chooses the libLLVM)

import json

import numpy as np
import pytest
import torch

from gva_mi.commands import checks
from gva_mi.body import Pose, Shape
from gva_mi.body.bench import FRAMES, bench_body, random_body
from gva_mi.errors import InputError
from gva_mi.splat.bench import BenchOptions


def test_every_stage_is_measured_for_every_batch():
    found = bench_body(repeats=2, seed=0, vertices=60)
    assert [batch.frames for batch in found.batches] == list(FRAMES)
    for batch in found.batches:
        assert [s.name for s in batch.stages] == ["joints", "blend shapes", "skinning", "body"]
        for stage in batch.stages:
            assert 0 < stage.forward[0] <= stage.forward[1] and 0 < stage.both[0] <= stage.both[1]
    assert json.loads(json.dumps(found.to_dict()))["vertices"] == 60
    table = found.table()
    assert "1 frame" in table and "100 frames" in table and table.count("blend shapes") == 2


def test_the_random_body_is_as_heavy_as_a_licensed_one():
    body = random_body(40, np.random.default_rng(0))
    assert len(body.pose_features) == 486
    assert body.frame_directions.shape == (486 + body.num_expressions, 120)
    assert (body.num_betas, body.num_expressions) == (10, 10)
    assert body(Pose.rest(2), Shape(torch.ones(10))).vertices.isfinite().all()


def test_the_command_writes_its_figures(monkeypatch, tmp_path, capsys):
    small = lambda repeats, seed: bench_body(repeats, seed, vertices=60)
    monkeypatch.setattr(checks, "bench_body", small)
    checks.bench("body", BenchOptions(repeats=1), json_file=tmp_path / "new" / "body.json")
    figures = json.loads((tmp_path / "new" / "body.json").read_text())
    assert [batch["frames"] for batch in figures["batches"]] == list(FRAMES)
    assert "60 vertices" in capsys.readouterr().out
    with pytest.raises(InputError, match="no --scene"):
        checks.bench("body", BenchOptions(), scene=tmp_path / "scene.npz")
