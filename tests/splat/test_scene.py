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


@pytest.fixture
def arrays():
    s = random_scene(torch.Generator().manual_seed(0), gaussians=5, degree=1)
    g, c = s.gaussians, s.camera
    named = {k: v.numpy() for k, v in g.arrays().items()}
    camera = {"viewmat": c.T_camera_world, "K": c.K, "width": c.width, "height": c.height}
    return named | camera | {"background": s.background.numpy()}


def test_a_file_is_the_scene_that_was_saved(arrays, tmp_path):
    np.savez(tmp_path / "scene.npz", **arrays)
    expected = random_scene(torch.Generator().manual_seed(0), gaussians=5, degree=1)
    found = Scene.load(tmp_path / "scene.npz")
    for name, tensor in expected.inputs().items():
        torch.testing.assert_close(found.inputs()[name], tensor, atol=0, rtol=0)
    assert torch.equal(draw(found).color, draw(expected).color)


def test_other_files_are_explained(arrays, tmp_path):
    for gone in ("means", "viewmat", "width", "sh"):
        rest = {k: v for k, v in arrays.items() if k != gone}
        np.savez(tmp_path / "scene.npz", **rest)
        with pytest.raises(InputError, match=gone):
            Scene.load(tmp_path / "scene.npz")
    nothing = Gaussians(*(torch.zeros(0, n) for n in (3, 4, 3)), torch.zeros(0), torch.zeros(0, 3))
    save_ply(tmp_path / "a.ply", nothing)
    with pytest.raises(InputError, match="holds no Gaussians"):
        Scene.load(tmp_path / "a.ply")
    with pytest.raises(InputError, match="no such file; expected a scene"):
        Scene.load(tmp_path / "missing.npz")
    (tmp_path / "text.npz").write_text("hello")
    with pytest.raises(InputError, match="not a readable .npz"):
        Scene.load(tmp_path / "text.npz")
    np.savez(tmp_path / "scene.npz", **arrays | {"quats": np.zeros((4, 4))})
    with pytest.raises(InputError, match="quats must be"):
        Scene.load(tmp_path / "scene.npz")


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
