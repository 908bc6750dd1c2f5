"""A mesh laid over a picture."""

import numpy as np
import torch

from gva_mi.body.pose import Shape
from gva_mi.mesh.overlay import overlay


def test_only_the_mesh_is_painted(scene, body, camera, true_pose):
    vertices = body(true_pose[0], Shape(torch.zeros(10))).vertices[0].detach()
    mask = scene.render(vertices, camera)[..., 3].numpy()
    image = np.zeros((*mask.shape, 3), np.float32)
    picture = overlay(image, camera, vertices, body.faces, scene)
    assert np.array_equal(picture, overlay(image, camera, vertices, body.faces))
    assert picture.shape == image.shape and picture.dtype == np.float32
    painted = (picture != image).any(-1)
    np.testing.assert_array_equal(painted, mask > 0.5)
