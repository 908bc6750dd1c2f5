"""docs/train_gaussians.py learns a scene and adds Gaussians."""

import importlib.util
import sys
from pathlib import Path

import pytest
import torch

from gva_mi.splat.scene import random_scene

PROGRAM = Path(__file__).parents[1] / "docs/train_gaussians.py"


@pytest.fixture(scope="module")
def program():
    spec = importlib.util.spec_from_file_location("train_gaussians", PROGRAM)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    yield module
    del sys.modules[spec.name]


def test_unseen_views_improve_and_gaussians_are_added(program):
    scene = random_scene(torch.Generator().manual_seed(0), gaussians=40)
    seen, unseen = program.Views.around(scene, 6, 32), program.Views.around(scene, 2, 32, 0.4)
    before, after = (program.train(scene, seen, steps, count=60) for steps in (0, 110))
    assert program.psnr(after, unseen) > program.psnr(before, unseen) + 5
    assert len(after["means"]) > len(before["means"]) == 60


def test_kept_rows_keep_their_adam_moments(program):
    params = {"a": torch.nn.Parameter(torch.arange(4.0)[:, None])}
    adam = torch.optim.Adam([{"params": [params["a"]], "name": "a", "lr": 0.0}])
    params["a"].grad = torch.tensor([[1.0], [2.0], [3.0], [4.0]])
    adam.step()
    kept, new = torch.tensor([True, False, True, False]), {"a": torch.tensor([[9.0]])}
    program._replace_rows(params, adam, kept, new)
    assert params["a"].flatten().tolist() == [0, 2, 9]
    (p,) = adam.param_groups[0]["params"]
    assert p is params["a"] and list(adam.state) == [p]
    assert torch.allclose(adam.state[p]["exp_avg"].flatten(), torch.tensor([0.1, 0.3, 0.0]))
