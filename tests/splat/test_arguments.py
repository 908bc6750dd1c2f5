"""Wrong input of ``render``: one sentence names the argument, and where it is wrong."""

from dataclasses import replace

import drjit.scalar
import numpy as np
import pytest
import torch
from drjit.llvm import TensorXf64
from samples.scenes import draw, in_drjit, scene

from gva_mi.splat import drjit_render as native
from gva_mi.splat.camera import Camera
from gva_mi.splat.gaussians import Gaussians
from gva_mi.splat.torch_render import render


def draw_drjit(s):
    return native.render(in_drjit(s.gaussians, TensorXf64), s.camera, s.options)


@pytest.mark.parametrize("name", ["means", "quats", "scales", "opacities", "colors", "sh"])
def test_numbers_that_are_not_finite_are_named(name):
    bad = float("nan") if name in ("means", "sh") else -float("inf")
    s = scene(degree=1 if name == "sh" else None)
    tensor = s.inputs()[name].clone()
    first = (7, *[1] * (tensor.ndim - 1))
    tensor[first] = tensor[8] = bad
    where = ", ".join(map(str, first))
    s = s.with_inputs(s.inputs() | {name: tensor})
    message = rf"{name}\[{where}\] is {bad}, must be finite"
    with torch.no_grad(), pytest.raises(ValueError, match=message):
        draw(s.to(torch.float32))


def test_a_background_that_is_not_finite_is_named():
    for bad in (float("nan"), float("inf")):
        background = torch.tensor([0, bad, 0], dtype=torch.float64)
        with pytest.raises(ValueError, match="background must be finite, got"):
            render(scene().gaussians, CAMERA, background=background)


def test_cameras_tensors_are_checked():
    s = scene()
    T, K = torch.tensor(s.camera.T_camera_world), torch.tensor(s.camera.K)
    for name, tensor, message in (
        ("T_camera_world", T * float("nan"), "must be rigid: finite"),
        ("T_camera_world", 1.1 * T, "must be rigid: finite"),
        ("T_camera_world", T[:3], r"T_camera_world must be \(4, 4\), got \(3, 4\)"),
        ("K", K * float("inf"), "fx, fy, cx, cy must be finite"),
        ("K", -K, "focal lengths must be positive"),
        ("K", K.float(), "K must be torch.float64"),
        ("K", K[0], r"K must be \(3, 3\), got \(3,\)"),
        ("K", TensorXf64(s.camera.K), r"K must be a tensor of shape \(3, 3\), got TensorXf64"),
    ):
        with pytest.raises(ValueError, match=message):
            draw(replace(s, camera=s.camera.with_matrices(**{name: tensor})))
    native_view = s.camera.with_matrices(K=K)
    for kind in (drjit.scalar.TensorXf, torch.tensor):
        with pytest.raises(ValueError, match=r"tensors of drjit.llvm or drjit.llvm.ad, got"):
            native.render(in_drjit(s.gaussians, kind), s.camera)
    with pytest.raises(ValueError, match="the camera's K must be a TensorXf64, got Tensor"):
        draw_drjit(replace(s, camera=native_view))


CAMERA = scene().camera
ZERO = torch.zeros(40, 4, dtype=torch.float64)
WRONG = {  # message; wrong array of 40 Gaussians
    r"means must be \(N, 3\), got \(40, 4\)": {"means": ZERO},
    r"quats must be \(N, 4\), got \(40, 3\)": {"quats": ZERO[:, :3]},
    r"opacities must be \(N,\), got \(40, 1\)": {"opacities": ZERO[:, :1]},
    r"scales must be \(N, 3\), got \(39, 3\)": {"scales": ZERO[1:, :3]},
    r"colors must be \(N, D\), got \(40,\)": {"colors": ZERO[:, 0]},
    r"colors must be \(N, D\), got \(40, 0\)": {"colors": ZERO[:, :0]},
    "16 or 25 coefficients, got 5": {"colors": None, "sh": ZERO[:, :1, None].expand(40, 5, 3)},
    "one dtype, got means torch.float64, quats torch.float32": {"quats": ZERO.float()},
    "means must be float32 or float64 on the CPU, got torch.int64": {"means": ZERO[:, :3].long()},
    "means must be float32 or float64 on the CPU, got torch.float16": {"means": ZERO.half()},
    "colors must be float32 or float64 on the CPU, got .* on meta": {
        "colors": torch.zeros(40, 3, dtype=torch.float64, device="meta")
    },
    "scales must be a torch tensor, got ndarray": {"scales": np.zeros((40, 3))},
}


def test_wrong_shapes_types_and_devices_are_named():
    for message, wrong in WRONG.items():
        with pytest.raises(ValueError, match=message):
            render(replace(scene().gaussians, **wrong), CAMERA)


def test_backgrounds_cameras_and_colours_are_checked():
    g = scene().gaussians
    with pytest.raises(ValueError, match=r"background must be \(3,\), got \(4,\)"):
        render(g, CAMERA, background=torch.zeros(4))
    with pytest.raises(ValueError, match="either colors"):
        Gaussians(g.means, g.quats, g.scales, g.opacities)
    with pytest.raises(ValueError, match="size must be 1x1 to"):
        Camera(1, 1, 0, 0, np.eye(4), 0, 5)


def test_more_pairs_than_indices_hold():
    n = 3000  # times the 262,144 tiles of the picture
    g = Gaussians(means=torch.tensor([[0.0, 0.0, 2.0]]).repeat(n, 1),
        quats=torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(n, 1), scales=torch.full((n, 3), 100.0),
        opacities=torch.ones(n), colors=torch.ones(n, 1))  # fmt: skip
    camera = Camera(2000, 2000, 1024, 1024, np.eye(4), 4096, 2048)
    with pytest.raises(ValueError, match=r"3000 Gaussians touch 786432000 tiles .* 536870911"):
        render(g, camera)


def test_a_bad_number_in_the_last_packet_is_found_where_nothing_is_drawn():
    s = scene(gaussians=1003)
    means, opacities = s.gaussians.means.clone(), s.gaussians.opacities.clone()
    means[1002, 2] = float("nan")
    opacities[1002] = 0
    with pytest.raises(ValueError, match=r"means\[1002, 2\] is nan"):
        draw(s.with_inputs(s.inputs() | {"means": means, "opacities": opacities}))
