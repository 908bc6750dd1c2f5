"""Scenes: files, windows of the picture, camera models, and the built-in person."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gva_mi.core.errors import InputError
from gva_mi.splat.axes import half_turned
from gva_mi.splat.formats.ply import save_ply
from gva_mi.splat.gaussians import Gaussians
from gva_mi.splat.scene import Scene, person_scene, random_scene
from gva_mi.splat.torch_render import render


def draw(scene):
    with torch.no_grad():
        return render(scene.gaussians, scene.camera, scene.options, scene.background)


def test_files_without_gaussians_raise_an_explanation(tmp_path):
    nothing = Gaussians(*(torch.zeros(0, n) for n in (3, 4, 3)), torch.zeros(0), torch.zeros(0, 3))
    save_ply(tmp_path / "a.ply", nothing)
    with pytest.raises(InputError, match="holds no Gaussians"):
        Scene.load(tmp_path / "a.ply")
    with pytest.raises(InputError, match="no such file; expected a .ply"):
        Scene.load(tmp_path / "missing.ply")


@pytest.mark.parametrize("model", ["pinhole", "ortho", "fisheye"])
def test_a_window_lacks_only_gaussians_outside_of_it(model):
    s = random_scene(torch.Generator().manual_seed(1), gaussians=80, width=48, height=40)
    s = s.with_inputs(s.inputs() | {"scales": 0.2 * s.gaussians.scales}).through(model)
    part = s.window(17, 9, 16, 12)
    assert 0 < len(part.gaussians) < 80
    cropped = replace(s, camera=s.camera.cropped(17, 9, 16, 12))
    assert torch.equal(draw(part).color, draw(cropped).color)


def test_gaussians_of_another_program_are_seen_upright_from_their_front(tmp_path):
    person = person_scene(np.random.default_rng(0), 500, 64).gaussians
    save_ply(tmp_path / "a.ply", half_turned(person))  # files have y down
    s = Scene.load(tmp_path / "a.ply")
    order = torch.cdist(person.means, s.gaussians.means).argmin(1)
    assert torch.allclose(s.gaussians.means[order], person.means, atol=1e-4)
    assert (
        s.camera.position[2] > s.gaussians.means[:, 2].max() and s.camera.T_camera_world[1, 1] < 0
    )
    assert len(s.gaussians) == 500 and (s.camera.width, s.camera.height) == (512, 512)
    alpha = draw(s.to(torch.float32)).alpha
    seen = torch.nonzero(alpha > 0.5)
    assert (seen.max(0).values - seen.min(0).values)[0] > 300  # it fills most of the picture
    assert alpha[0].max() < 0.5 and alpha[-1].max() < 0.5
