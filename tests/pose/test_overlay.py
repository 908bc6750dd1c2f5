"""The body laid over a picture."""

import numpy as np

from gva_mi.body.pose import Shape
from gva_mi.pose.overlay import overlay, strip


def test_only_the_body_is_painted(clip, body, true_pose):
    frame = next(clip.frames())
    vertices = body(true_pose[0], Shape(clip.shape.betas)).vertices[0]
    picture = overlay(frame, vertices, body.faces)
    assert picture.shape == frame.image.shape and picture.dtype == np.float32
    painted = (picture != frame.image).any(-1)
    np.testing.assert_array_equal(painted, frame.mask > 0.5)


def test_rows_lie_below_each_other():
    a, b = np.zeros((4, 6, 3)), np.full((4, 6, 3), 0.5)
    sheet = strip([[a, b], [b]], gap=2)
    assert sheet.shape == (10, 14, 3)
    assert (sheet[:4, :6] == 0).all() and (sheet[6:, :6] == 0.5).all() and (sheet[4:6] == 1).all()
