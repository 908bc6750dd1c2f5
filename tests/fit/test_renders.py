"""Renders of camera shots: layers without background, and RGBA."""

import numpy as np
import pytest

from gva_mi.fit.renders import CameraShot, over, render_frame, render_layer, render_shots


@pytest.fixture
def layer(known, turning, camera):
    return render_layer(known, turning(1)[0], camera)


def test_shots_are_renders_of_their_frames(known, turning, camera):
    motion, calls = turning(3)[0], []
    shots = [CameraShot(2, camera), CameraShot(0, camera.zoomed(0.5))]
    found = list(
        render_shots(known, motion, shots, lambda done, total: calls.append((done, total)))
    )
    assert calls == [(1, 2), (2, 2)]
    for layer, shot in zip(found, shots, strict=True):
        image = render_frame(known, motion[shot.frame], shot.camera)
        assert np.abs(over(layer, np.ones(3)).astype(int) - image).max() <= 1


def test_a_layer_lies_over_a_colour_as_the_renderer_does_it(layer, known, turning, camera):
    colour = (0.2, 0.9, 0.4)
    image = render_frame(known, turning(1)[0], camera, background=colour)
    assert np.abs(over(layer, np.array(colour)).astype(int) - image).max() <= 1
