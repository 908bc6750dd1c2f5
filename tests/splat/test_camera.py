"""Cameras: projection of each model, derived views, and wrong arguments."""

from dataclasses import replace

import drjit as dr
import numpy as np
import pytest
import torch
from drjit.llvm.ad import TensorXf64

from gva_mi.splat.camera import Camera, look_at
from gva_mi.splat.reference import picture_point


def camera(**changes):
    values = {"fx": 50.0, "fy": 60.0, "cx": 31.0, "cy": 25.0, "width": 64, "height": 48}
    pose = {"T_camera_world": look_at((1.0, 2.0, 3.0), (0.0, 0.5, 0.0))}
    return Camera(**(values | pose | changes))


@pytest.mark.parametrize("model", ["pinhole", "ortho", "fisheye"])
def test_matrices_and_back(model):
    c = camera(model=model)
    assert c.with_matrices(None, None).model == model
    again = Camera.from_matrices(c.K, c.T_camera_world, 64, 48, model)
    x = np.array([0.1, 0.2, 0.3])
    np.testing.assert_array_equal(again.project(x), c.project(x))
    moved = c.with_matrices(np.eye(4), 2 * c.K)
    assert (moved.fx, moved.cy, moved.width) == (100, 50, 64)
    np.testing.assert_array_equal(moved.position, 0)
    centre = np.array([c.cx, c.cy])
    np.testing.assert_allclose(c.zoomed(1.3).project(x) - centre, 1.3 * (c.project(x) - centre))


@pytest.mark.parametrize("message, change", [
    ("model must be one of pinhole, ortho, fisheye, got 'ftheta'", {"model": "ftheta"}),
    ("focal lengths must be positive", {"fx": 0.0}),
    ("must be finite", {"cx": float("nan")}),
    ("must be rigid", {"T_camera_world": 2 * np.eye(4)}),
    (r"T_camera_world must be \(4, 4\)", {"T_camera_world": np.eye(3)}),
    ("size must be 1x1 to 268,435,456 pixels, got 64x0", {"height": 0}),
    ("pixels, got 1000000000x48", {"width": 10**9}),  # 200 GB
])  # fmt: skip
def test_wrong_arguments_are_named(message, change):
    with pytest.raises(ValueError, match=message):
        camera(**change)


@pytest.mark.parametrize("entry", [(0, 1), (1, 0), (2, 0), (2, 1)])
def test_a_skew_is_refused_and_not_dropped(entry):
    K = camera().K
    K[entry] = 1e-6  # as a calibration's rounding
    assert Camera.from_matrices(K, np.eye(4), 64, 48).K[0, 1] == 0
    for number in (0.5, -0.5, np.nan):
        K[entry] = number
        for given in (K, torch.tensor(K)):
            with pytest.raises(ValueError, match=r"K must be fx, 0, cx, .* got \[50"):
                Camera.from_matrices(given, np.eye(4), 64, 48)


def part_of(view, change):
    return view.resized(32, 36) if change == "resized" else view.cropped(7, -3, 20, 30)


@pytest.mark.parametrize("change", ["resized", "cropped"])
@pytest.mark.parametrize("kind", ["torch", "drjit"])
def test_tensors_of_a_part_of_the_view_are_differentiable_by_the_whole(change, kind):
    c = camera()
    K = torch.tensor(c.K, requires_grad=True) if kind == "torch" else TensorXf64(c.K)
    dr.enable_grad(K) if kind == "drjit" else None
    part = part_of(c.with_matrices(K=K), change)
    np.testing.assert_allclose(
        part.tensors.K.detach().numpy() if kind == "torch" else dr.detach(part.tensors.K).numpy(),
        part_of(c, change).K,
        rtol=1e-15,
    )
    if kind == "torch":
        (grad,) = torch.autograd.grad(part.tensors.K.sum(), K)
    else:
        dr.backward(dr.sum(part.tensors.K))
        grad = dr.grad(K)
    expected = np.ones((3, 3))
    if change == "resized":
        expected[0], expected[1] = 32 / 64, 36 / 48
    np.testing.assert_allclose(grad.numpy(), expected)
    assert part.tensors.T_camera_world is None


def test_cameras_with_the_same_numbers_are_equal():
    camera = Camera(10.0, 11.0, 4.0, 3.0, np.eye(4), 8, 6)
    same = Camera.from_matrices(camera.K, np.eye(4), 8, 6)
    moved = replace(camera, T_camera_world=look_at((0, 0, 2), (0, 0, 0)))
    others = [replace(camera, model="ortho"), replace(camera, fx=10.5), moved]
    assert camera == same and hash(camera) == hash(same)
    assert len({camera, same, *others}) == 4 and camera != 1


def test_a_model_without_a_formula_is_refused():
    """And is not drawn as the last one."""
    camera = Camera(50, 50, 32, 32, np.eye(4), 64, 64)
    object.__setattr__(camera, "model", "new")
    with pytest.raises(ValueError, match="unknown camera model 'new'"):
        camera.project(np.ones((1, 3)))
    with pytest.raises(ValueError, match="unknown camera model 'new'"):
        picture_point(torch.ones(3), torch.eye(3), "new")
