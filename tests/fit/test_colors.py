"""Colours of the body from the pictures of a video."""

import numpy as np
import torch

from gva_mi.fit.colors import seen_colors
from gva_mi.mesh.surface import as_scipy, uniform_laplacian, vertex_normals
from gva_mi.subject.splits import Splits


def test_a_video_of_a_known_person_gives_back_its_colors(video, body, known):
    x = body.v_template
    true = 0.5 + 0.4 * torch.sin(torch.stack([9 * x[:, 0], 11 * x[:, 1], 7 * x.sum(1)], dim=1))
    error = (seen_colors(video, body) - true).abs().mean()
    assert error < 0.4 * (true - true.mean(0)).abs().mean()


def test_a_side_that_is_never_seen_has_the_colors_around_it(video, body):
    """Harmonic: no unseen vertex is brighter or darker than all its neighbours."""
    front = type(video)(**{**vars(video), "splits": Splits([0], [])})
    colors = seen_colors(front, body).double().numpy()
    behind = vertex_normals(body.v_template, body.faces)[:, 2] < -0.95
    from_means = as_scipy(uniform_laplacian(body.faces.numpy(), len(colors))) @ colors
    assert np.abs(from_means[behind]).max() < 1e-4
    assert colors[behind].std(0).max() > 0.02


def test_test_frames_are_not_used(video, body):
    before = seen_colors(video, body)
    fewer = type(video)(**{**vars(video), "splits": Splits(video.splits.train, [])})
    assert torch.equal(seen_colors(fewer, body), before)
