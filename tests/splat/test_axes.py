"""Half a turn about x: the picture turns with the camera; signs agree with public converters."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gva_mi.body.rotations import to_matrices
from gva_mi.readers.up_axis import UP_AXES, turn_to_y
from gva_mi.splat.axes import half_turned, rotated
from gva_mi.splat.gaussians import Gaussians
from gva_mi.splat.scene import random_scene
from gva_mi.splat.torch_render import render

F = np.diag([1.0, -1, -1, 1])


def test_a_camera_turned_with_the_gaussians_sees_the_same_picture():
    s = random_scene(torch.Generator().manual_seed(0), gaussians=30, degree=4).to(torch.float32)
    g, camera = s.gaussians, replace(s.camera, T_camera_world=s.camera.T_camera_world @ F)
    full = torch.rand(30, 3, 3, generator=torch.Generator().manual_seed(1)) / 10
    covars = (full @ full.mT + 0.001 * torch.eye(3))[:, *torch.triu_indices(3, 3)]
    for given in (g, Gaussians(g.means, None, None, g.opacities, sh=g.sh, covars=covars)):
        with torch.no_grad():
            plain = render(given, s.camera, s.options, s.background.float())
            turned = render(half_turned(given), camera, s.options, s.background.float())
            wrong = render(replace(half_turned(given), sh=given.sh), camera, s.options)
        assert (plain.color - turned.color).abs().max() < 1e-5
        assert (plain.color - wrong.color).abs().max() > 0.01  # it sees the colours' directions
        again = half_turned(half_turned(given)).arrays()
        assert all(torch.equal(again[name], x) for name, x in given.arrays().items())


@pytest.mark.parametrize("up", UP_AXES)
def test_a_camera_rotated_with_the_gaussians_sees_the_same_picture(up):
    """Quarter turns, and one about an oblique axis, with colours of degree 4."""
    s = random_scene(torch.Generator().manual_seed(0), gaussians=30, degree=4)
    for R in (to_matrices(turn_to_y(up)), to_matrices(turn_to_y(up) + [0.3, -0.2, 0.5])):
        T = s.camera.T_camera_world.copy()
        T[:3, :3] = T[:3, :3] @ R.T
        camera, g = replace(s.camera, T_camera_world=T), rotated(s.gaussians, R)
        with torch.no_grad():
            plain = render(s.gaussians, s.camera, s.options, s.background)
            turned = render(g, camera, s.options, s.background)
        assert (plain.color - turned.color).abs().max() < 1e-8
    axis = torch.eye(3)["xyz".index(up[-1])] * (-1 if up[0] == "-" else 1)
    assert np.allclose(to_matrices(turn_to_y(up)) @ axis.numpy(), [0, 1, 0])


def test_signs_equal_niantics_converter_from_rdf_to_rub():
    """By its table of flips for degrees 1 to 3, with x kept, y and z turned.

    (For the last of degree 4, which is even in y and z, its table of 2026 has the sign of y.)
    """
    x, y, z = 1, -1, -1
    flips = [y, z, x, x * y, y * z, 1, x * z, 1, y, x * y * z, y, z, x, z, x]
    ones = torch.ones(1, 16, 3)
    g = half_turned(
        Gaussians(torch.ones(1, 3), torch.ones(1, 4), ones[0, :1], ones[:, 0, 0], sh=ones)
    )
    assert g.sh[0, :, 1].tolist() == [1, *flips]
    assert g.means.tolist() == [[x, y, z]] and g.quats.tolist() == [[1, y * z, x * z, x * y]]
