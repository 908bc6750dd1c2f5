"""The renderer's gradients equal the reference's by every method, and planted errors are found."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from samples.bent import bent

from gva_mi.gradcheck import gradcheck
from gva_mi.splat import reference, render
from gva_mi.splat.camera import Camera, CameraTensors
from gva_mi.splat.gaussians import Image
from gva_mi.splat.options import SplatOptions
from gva_mi.splat.scene import random_scene

METHODS = {"adjoint f32", "adjoint f64", "tangent f32", "tangent f64", "differences"}
CUT_OFFS = {"alpha_min": 0.02, "alpha_max": 0.9, "transmittance_min": 0.05, "blur": 1.0}


def scene(seed=1, **kwargs):
    return random_scene(torch.Generator().manual_seed(seed), **kwargs)


def by_options(s, **options):
    return replace(s, options=SplatOptions(**options))


def through(s, model):
    """The scene by parallel rays, or by a lens of wide angle amid its Gaussians."""
    if model == "ortho":
        return replace(s, camera=replace(s.camera, model=model, fx=6.0, fy=7.0))
    T, c = np.eye(4), s.camera
    T[:3, 3] = (0.1, -0.1, 0.9)
    return replace(s, camera=Camera(10.0, 11.0, c.cx, c.cy, T, c.width, c.height, model))


def out_of_view(s):
    return s.with_inputs(s.inputs() | {"means": s.gaussians.means + 100})


FEW = {"gaussians": 20, "width": 16, "height": 14, "degree": 1}
SCENES = {
    "sh 4": lambda: scene(degree=4),
    "chunks of channels, odd size": lambda: scene(channels=11, width=23, height=17),
    "other cut-offs": lambda: by_options(scene(**FEW), antialiased=True, **CUT_OFFS),
    "ortho": lambda: through(scene(**FEW), "ortho"),
    "ortho, antialiased": lambda: by_options(through(scene(**FEW), "ortho"), antialiased=True),
    "fisheye": lambda: through(scene(**FEW), "fisheye"),
    "fisheye, antialiased": lambda: by_options(through(scene(**FEW), "fisheye"), antialiased=True),
    "without depth": lambda: by_options(scene(gaussians=10, width=12, height=9), depth=False),
    "nothing in view": lambda: out_of_view(scene(gaussians=10, width=9, height=5)),
}


@pytest.fixture(scope="module")
def small():
    return gradcheck(render, scene(gaussians=6, width=12, height=9))


@pytest.mark.parametrize("name", SCENES)
def test_every_gradient_is_right(name):
    s = SCENES[name]()
    report = gradcheck(render, s)
    assert report.passed and not report.notes, report.table()
    assert report.band < 0.02 * report.pixels
    assert ("depth" in {row.name for row in report.rows}) == s.options.depth
    assert (report.maps.image.std(axis=(0, 1)).max() > 0.05) == (name != "nothing in view")


def test_an_empty_scene():
    report = gradcheck(render, scene(gaussians=0, width=9, height=5))
    assert report.passed, report.table()
    assert (report.gaussians, report.pixels, report.band) == (0, 45, 0)


def test_names_every_input_and_image(small):
    inputs = set(scene().with_camera_inputs().inputs())
    gaussians = {"means", "quats", "scales", "opacities", "colors"}
    assert inputs == gaussians | {"background", "T_camera_world", "K"}
    found = {method: set() for method in {row.method for row in small.rows}}
    for row in small.rows:
        found[row.method].add(row.name)
    assert found.keys() == METHODS and not small.notes
    for method, names in found.items():
        images = {"color", "alpha", "depth"} if method.startswith("adjoint") else set()
        assert names == inputs | images, method


def test_pixels_at_a_step_are_left_out_of_both_precisions():
    """One Gaussian whose alpha at a pixel is the cut-off: no method may look at that pixel."""
    s = scene(gaussians=1, width=12, height=9)
    camera, cut = replace(s.camera, fx=10.0, fy=10.0, cx=6.5, cy=4.5), s.options.alpha_min
    view = torch.tensor(camera.T_camera_world)
    means = (torch.linalg.inv(view) @ torch.tensor([0, 0, 2.0, 1]).double())[None, :3]
    inputs = s.inputs() | {"means": means, "opacities": torch.tensor([cut]).double()}
    report = gradcheck(render, replace(s.with_inputs(inputs), camera=camera))
    assert report.band == 1 and report.maps.band[4, 6]
    assert report.passed, report.table()
    assert "1 at a step were left out" in report.verdict


def test_neighbours_in_depth_that_may_swap_are_a_step():
    s = scene(gaussians=2, width=12, height=9)
    forward = torch.tensor(s.camera.T_camera_world[2, :3].copy())
    for gap, tied in ((1e-7, True), (1e-3, False), (0.0, False)):
        means = torch.stack([0 * forward, gap * forward])
        big = {"scales": torch.full((2, 3), 0.5).double(), "means": means}
        moved = s.with_inputs(s.inputs() | big)
        band = reference.threshold_band(moved.gaussians, moved.camera)
        assert (band.double().mean() > 0.5) == tied, gap


def test_a_wrong_adjoint_is_found():
    def wrong(gaussians, camera, options, background):
        gaussians = replace(gaussians, scales=bent(gradient=2.0)(gaussians.scales))
        return Image(**vars(render(gaussians, camera, options, background)))

    report = gradcheck(wrong, scene(gaussians=12, width=16, height=16))
    assert not report.passed
    assert {row.name for row in report.rows if not row.passed} == {"scales"}
    assert "WRONG" in report.verdict and "FAILS" in report.table()
    assert {row.method for row in report.rows if not row.passed} >= {"adjoint f32", "adjoint f64"}


def test_a_wrong_picture_is_found():
    def wrong(gaussians, camera, options, background):
        image = render(gaussians, camera, options, background)
        color = image.color.clone()
        color[3, 4] += 1e-3
        return replace(image, color=color)

    report = gradcheck(wrong, scene(gaussians=12, width=16, height=16))
    failed = [row for row in report.rows if not row.passed]
    assert {row.name for row in failed} == {"color"}
    assert all(row.where[:2] == (3, 4) for row in failed)


def test_what_a_renderer_lacks_is_noted():
    def single(gaussians, camera, options, background):
        if gaussians.means.dtype != torch.float32:
            raise TypeError("float32 only")
        fixed = replace(camera, tensors=CameraTensors())
        return render(gaussians, fixed, options, background)

    report = gradcheck(single, scene(gaussians=12, width=16, height=16))
    assert any("float32 only" in note for note in report.notes)
    assert any("T_camera_world" in note for note in report.notes)
    assert {row.method for row in report.rows} == {"adjoint f32", "tangent f32"}
    assert report.passed, report.table()


def test_a_wrong_tangent_is_found():
    def wrong(gaussians, camera, options, background):
        opacities = bent(tangent=1.001)(gaussians.opacities)
        return render(replace(gaussians, opacities=opacities), camera, options, background)

    report = gradcheck(wrong, scene(gaussians=12, width=16, height=16))
    failed = {(row.method, row.name) for row in report.rows if not row.passed}
    assert failed == {("tangent f32", "opacities"), ("tangent f64", "opacities")}
