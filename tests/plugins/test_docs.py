"""docs/plugins.md: its pictures are what the plugins show, its examples run, its table is whole."""

import re
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "plugins.md").read_text()
SPLATS, NORMALS = (
    PAGE.partition(f"## `{name}`")[2].partition("\n## ")[0]
    for name in ("gaussian_splat", "mesh_normals")
)
SIZE = 160


def reference_picture(scenes):
    """Normals, mask, depth, and the derivatives of normals and mask, side by side (H, 5 W, 3)."""
    ball, ring = scenes.sphere, scenes.torus
    parts = [ball(40, 60, 0.24, (-0.2, 0.2, 0.7)), ring(96, 48),
        ball(40, 60, 0.3, (0.4, -0.1, 0.1))]  # fmt: skip
    shapes = {f"m{k}": scenes.mesh(f"m{k}", *part) for k, part in enumerate(parts)}
    scene = mi.load_dict({"type": "scene", **shapes})
    parameters, sensor = mi.traverse(scene), scenes.camera(SIZE)
    integrator = mi.load_dict({"type": "mesh_normals", "channels": "normal, mask, depth"})
    x = mi.Float(0)
    dr.enable_grad(x)
    vertices = parts[0][0]
    to_right = mi.Float(np.tile([1.0, 0.0, 0.0], len(vertices)).astype(np.float32))
    start = mi.Float(vertices.ravel().astype(np.float32))
    parameters["m0.vertex_positions"] = start + x * to_right
    parameters.update()
    image = mi.render(scene, parameters, sensor=sensor, integrator=integrator, spp=16)
    dr.forward(x)
    derivative, image = np.array(dr.grad(image)), np.array(image)
    mask = image[..., 3:4]
    grey = lambda x: np.repeat(x, 3, axis=2)
    depth = np.divide(image[..., 4:5], mask, out=np.zeros_like(mask), where=mask > 0)
    near, far = depth[depth > 0].min(), depth.max()
    panels = (0.5 * mask + 0.5 * image[..., :3] * [1, -1, -1], grey(mask),
        grey(mask * (1 - 0.8 * (depth - near) / (far - near))), 0.5 + derivative[..., :3] / 80,
        grey(0.5 + derivative[..., 3:4] / 80))  # fmt: skip
    return np.clip(np.concatenate(panels, axis=1), 0, 1)


def test_the_picture_is_what_the_plugin_shows(scenes):
    picture = np.round(255 * reference_picture(scenes))
    stored = np.array(mi.Bitmap(str(DOCS / "mesh_normals.png"))).astype(float)
    assert stored.shape == picture.shape
    off = np.abs(stored - picture).max(2) > 2
    assert off.mean() < 2e-3  # a ray that grazes an edge may fall to its other side elsewhere


def test_the_examples_of_mesh_normals_run(scenes):
    names = {}
    for block in re.findall(r"```python\n(.*?)```", NORMALS, re.DOTALL):
        exec(block, names)
    assert names["image"].shape == (64, 64, 5)
    assert np.array(names["grad"]).any()
    for block in re.findall(r"```xml\n(.*?)```", NORMALS, re.DOTALL):
        mi.load_string(block.replace("<integrator ", '<integrator version="3.0.0" ', 1))


@pytest.mark.parametrize("samples", [1, pytest.param(64, marks=pytest.mark.slow)])
def test_the_example_of_gaussian_splat_makes_its_picture(samples, scenes, tmp_path, monkeypatch):
    """With one sample the part that has no noise."""
    monkeypatch.chdir(tmp_path)
    (program,) = re.findall(r"```python\n(.*?)```", SPLATS, re.DOTALL)
    assert '"sample_count": 64' in program
    names, few = {}, program.replace('"sample_count": 64', f'"sample_count": {samples}')
    exec(compile(few, "plugins.md", "exec"), names)
    made, shown = (np.array(mi.Bitmap(str(p / "gaussian_splat.png"))) for p in (tmp_path, DOCS))
    off = made.astype(float) - shown
    assert np.abs(off[:, 320:640]).max() <= 1
    if samples == 64:
        assert np.sqrt(np.mean(off**2)) < 1
        error = np.array(names["traced"]) - np.array(names["splatted"])
        assert f"agree to {-10 * np.log10(np.mean(error**2)):.0f} dB" in SPLATS


def test_every_parameter_of_gaussian_splat_is_documented(scenes):
    """Mitsuba refuses unknown properties, so the table lists all."""
    table = re.findall(r"^\| `(\w+)` \|", SPLATS, re.MULTILINE)
    first = ["meshes", "proxy", "bake", "background"]
    assert table == [*first, "srgb_primitives", "depth", "blur", "antialiased"]
    given = {"srgb_primitives": False, "depth": True, "blur": 0.1, "antialiased": True}
    mi.load_dict({"type": "gaussian_splat", "meshes": "none", "background": 0.5} | given)
    mi.load_dict({"type": "gaussian_splat", "meshes": "lit", "proxy": "mesh", "bake": 8} | given)
