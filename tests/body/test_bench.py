import gva_mi  # noqa: F401, I001  (first: it chooses the libLLVM)

import json

import numpy as np
import torch

from gva_mi.body import Pose, Shape
from gva_mi.body.bench import FRAMES, bench_body, random_body


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
