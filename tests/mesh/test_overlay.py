"""A mesh laid over a picture."""

import numpy as np
import torch

from gva_mi.body.pose import Shape
from gva_mi.mesh.overlay import overlay, shaded, strip


def test_only_the_mesh_is_painted(scene, body, camera, true_pose):
    vertices = body(true_pose[0], Shape(torch.zeros(10))).vertices[0].detach()
    mask = scene.render(vertices, camera)[..., 3].numpy()
    image = np.zeros((*mask.shape, 3), np.float32)
    picture = overlay(image, camera, vertices, body.faces)
    assert picture.shape == image.shape and picture.dtype == np.float32
    painted = (picture != image).any(-1)
    np.testing.assert_array_equal(painted, mask > 0.5)


def test_rows_lie_below_each_other():
    a, b = np.zeros((4, 6, 3)), np.full((4, 6, 3), 0.5)
    sheet = strip([[a, b], [b]], gap=2)
    assert sheet.shape == (10, 14, 3)
    assert (sheet[:4, :6] == 0).all() and (sheet[6:, :6] == 0.5).all() and (sheet[4:6] == 1).all()


def test_a_surface_alone_is_lit_from_the_camera_and_fills_the_picture(body):
    front, side = (shaded(body.v_template, body.faces, a, size=64) for a in (0.0, np.pi / 2))
    for image in (front, side):
        assert image.shape == (64, 64, 3) and (image[0, 0] == 1).all()
        assert image.min() > 0 and image.max() == 1
    seen = [(image < 1).any(-1) for image in (front, side)]
    assert 0.8 * 64 < seen[0].any(0).sum() <= 64  # arm to arm
    assert seen[1].any(0).sum() < 0.4 * 64
    np.testing.assert_allclose(seen[0].any(1).sum(), seen[1].any(1).sum(), atol=2)
