"""The commands that examine the kernels: what they write, and what they refuse."""

import json

import numpy as np
import pytest
import torch

from gva_mi.commands import checks
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
    checks.gradcheck(checks.GradcheckOptions(8, 2), scene=scene, out=tmp_path / "out")
    figures = json.loads((tmp_path / "out" / checks.REPORT).read_text())
    assert figures["passed"] and len(figures["scenes"]) == 2
    assert (tmp_path / "out" / checks.PICTURE).stat().st_size > 1000
    assert "gradients are right in all 2 windows" in capsys.readouterr().out


@pytest.mark.parametrize("model", ["pinhole", "ortho", "fisheye"])
def test_gradcheck_looks_through_other_cameras(model, scene, capsys):
    changes = {"camera_model": model, "antialiased": True, "channels": 5, "images": ("depth",)}
    checks.gradcheck(checks.GradcheckOptions(8, 1, **changes), scene=scene)
    out = capsys.readouterr().out
    assert "gradients are right in all 1 windows" in out and " colors " in out


@pytest.mark.parametrize("wrong", [{"window": 0}, {"count": 0}, {"channels": -1}, {"images": ()}])
def test_gradcheck_refuses_what_shows_nothing(wrong):
    with pytest.raises(InputError, match="must be|1 or more"):
        checks.GradcheckOptions(**wrong)


def test_gradcheck_fails_where_a_gradient_is_wrong(scene, monkeypatch):
    def wrong(gaussians, camera, options, background):
        image = render(gaussians, camera, options, background)
        return type(image)(1.01 * image.color, image.alpha, image.depth)

    render = checks.render
    monkeypatch.setattr(checks, "render", wrong)
    with pytest.raises(InputError, match="WRONG"):
        checks.gradcheck(checks.GradcheckOptions(8, 1), scene=scene)


def test_bench_writes_its_figures(scene, tmp_path, capsys):
    few = BenchOptions(repeats=2, calls=2, no_growth=True, no_gsplat=True)
    checks.bench("splat", few, scene=scene, json_file=tmp_path / "new" / "bench.json")
    figures = json.loads((tmp_path / "new" / "bench.json").read_text())
    assert figures["gaussians"] == 8 and figures["growth"] == []
    assert "composite, adjoint" in capsys.readouterr().out
