"""The commands that examine the kernels: what they write, and what they refuse."""

import json

import numpy as np
import pytest
import torch

from gva_mi import checks
from gva_mi.errors import InputError
from gva_mi.splat.bench import BenchOptions
from gva_mi.splat.scene import random_scene


@pytest.fixture
def scene(tmp_path):
    s = random_scene(torch.Generator().manual_seed(0), gaussians=8, width=20, height=16)
    c = s.camera
    arrays = {k: v.numpy() for k, v in s.inputs().items()}
    camera = {"viewmat": c.T_camera_world, "K": c.K, "width": c.width, "height": c.height}
    np.savez(tmp_path / "scene.npz", **arrays, **camera)
    return tmp_path / "scene.npz"


def test_gradcheck_writes_figures_and_a_picture(scene, tmp_path, capsys):
    checks.gradcheck(scene=scene, out=tmp_path / "out", window=8, count=2)
    figures = json.loads((tmp_path / "out" / checks.REPORT).read_text())
    assert figures["passed"] and len(figures["scenes"]) == 2
    assert (tmp_path / "out" / checks.PICTURE).stat().st_size > 1000
    assert "gradients are right in all 2 windows" in capsys.readouterr().out


@pytest.mark.parametrize("size", [{"window": 0}, {"count": 0}])
def test_gradcheck_refuses_empty_windows(scene, size):
    with pytest.raises(InputError, match="must be positive"):
        checks.gradcheck(scene=scene, **size)


def test_gradcheck_fails_where_a_gradient_is_wrong(scene, monkeypatch):
    def wrong(gaussians, camera, options, background):
        image = render(gaussians, camera, options, background)
        return type(image)(1.01 * image.color, image.alpha, image.depth)

    render = checks.render
    monkeypatch.setattr(checks, "render", wrong)
    with pytest.raises(InputError, match="WRONG"):
        checks.gradcheck(scene=scene, window=8, count=1)


def test_bench_writes_its_figures(scene, tmp_path, capsys):
    few = BenchOptions(repeats=2, calls=2, most_gaussians=0, most_pixels=64, no_gsplat=True)
    checks.bench("splat", few, scene=scene, json_file=tmp_path / "new" / "bench.json")
    figures = json.loads((tmp_path / "new" / "bench.json").read_text())
    assert figures["gaussians"] == 8 and figures["growth"] == []
    assert "composite, adjoint" in capsys.readouterr().out
