"""Degenerate scenes: pictures match the reference, and all derivatives are finite."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from samples.scenes import double, draw, scene

from gva_mi.gradcheck import tangent_image
from gva_mi.splat import reference
from gva_mi.splat.camera import Camera
from gva_mi.splat.torch_render import render

CAMERA = scene().camera
EYE = torch.tensor(CAMERA.position.copy())
FORWARD = torch.tensor(CAMERA.T_camera_world[2, :3].copy())
STACK = torch.linspace(0, 0.1, 16, dtype=torch.float64)[:, None] * FORWARD
FLAT = torch.zeros(40, 3, dtype=torch.float64)
IMAGES = ("color", "alpha", "depth")
SCENES = {  # number of Gaussians, and changed arrays
    "none": (0, {}),
    "one": (1, {}),
    "all behind": (40, {"means": scene().gaussians.means + 2 * EYE}),
    "at the near plane": (2, {"means": EYE + double([0.010001], [0.009999]) * FORWARD}),
    "at the camera": (2, {"means": EYE + double([0.0], [1e-6]) * FORWARD}),
    "at the edge": (1, {"means": double([0.86, 0.0, 0.0])}),
    "far away": (40, {"means": 1e6 * scene().gaussians.means}),
    "equal depths": (40, {"means": FLAT}),
    "opacity 0": (40, {"opacities": FLAT[:, 0]}),
    "opacity 1": (40, {"opacities": FLAT[:, 0] + 1}),
    "opaque stack": (
        16,
        {"means": STACK, "opacities": FLAT[:16, 0] + 1, "scales": FLAT[:16] + 0.3},
    ),
    "needles": (40, {"scales": FLAT + double(2.0, 1e-5, 1e-5)}),
    "points": (40, {"scales": FLAT}),
    "larger than the world": (40, {"scales": FLAT + 1e3}),
    "zero quaternions": (40, {"quats": torch.zeros(40, 4, dtype=torch.float64)}),
    "long quaternions": (40, {"quats": 1e3 * scene().gaussians.quats}),
}


def made(name, dtype=torch.float64, **kwargs):
    n, arrays = SCENES[name]
    s = scene(**kwargs)
    first = {k: v if k == "background" else v[:n] for k, v in s.inputs().items()}
    s = s.with_inputs(first | {k: v.reshape(n, *first[k].shape[1:]) for k, v in arrays.items()})
    return s.with_camera_inputs().to(dtype)


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("dtype, atol", [(torch.float32, 3e-5), (torch.float64, 1e-11)])
def test_pictures_match_the_reference_and_all_derivatives_are_finite(name, dtype, atol):
    """Of colours in float64, and of harmonics with antialiasing in float32."""
    s = made(name, dtype, degree=1 if dtype == torch.float32 else None)
    s = replace(s, options=replace(s.options, antialiased=dtype == torch.float32))
    image = draw(s)
    (image.color.sum() + image.alpha.square().sum() + image.depth.sum()).backward()
    for key, tensor in s.inputs().items():
        assert torch.isfinite(tensor.grad).all(), key
        tangent = tangent_image(render, s, key, torch.ones_like(tensor))
        assert all(torch.isfinite(getattr(tangent, k)).all() for k in IMAGES), key
    with torch.no_grad():
        expected = reference.render(s.gaussians, s.camera, s.options, s.background)
        band = reference.threshold_band(s.gaussians, s.camera, s.options)
    for key in IMAGES:
        off = (getattr(image, key).double() - getattr(expected, key))[~band]
        assert not off.numel() or off.abs().max() < atol, key


@pytest.mark.parametrize(("width", "height"), [(1, 1), (8, 4), (9, 5), (130, 1)])
def test_any_size_of_picture(width, height):
    s = scene(width=width, height=height).to(torch.float64)
    other = s.to(torch.float64)
    image = render(s.gaussians, s.camera, s.options, s.background)
    expected = reference.render(other.gaussians, other.camera, other.options, other.background)
    for name in IMAGES:
        found = getattr(image, name)
        assert found.shape[:2] == (height, width)
        torch.testing.assert_close(found, getattr(expected, name), atol=1e-12, rtol=0)
    for each in (image, expected):
        (each.color.square().sum() + each.depth.sum()).backward()
    for name, tensor in s.inputs().items():
        torch.testing.assert_close(tensor.grad, other.inputs()[name].grad, rtol=1e-9, atol=1e-11)


def test_a_gaussian_on_a_fisheyes_axis():
    camera = Camera(12, 12, 16, 16, np.eye(4), 32, 32, "fisheye")
    found = []
    for x in (0.0, 1e-9):
        s = scene(gaussians=1)
        s = s.with_inputs(s.inputs() | {"means": double([x, 0.0, 1.5])})
        s = replace(s, camera=camera).to(torch.float64)
        image = render(s.gaussians, s.camera, s.options, s.background)
        (image.color.square().sum() + image.depth.sum()).backward()
        found.append([tensor.grad for tensor in s.inputs().values()])
    assert found[0][0].abs().max() > 0
    for a, b in zip(*found, strict=True):
        torch.testing.assert_close(a, b, rtol=1e-6, atol=1e-7)
