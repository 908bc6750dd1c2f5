"""Colours of the body from the pictures of a video."""

import torch

from gva_mi.data.video import Splits
from gva_mi.fit.colors import seen_colors
from gva_mi.mesh.surface import vertex_normals


def test_a_video_of_a_known_person_gives_back_its_colors(video, body, known):
    x = body.v_template
    true = 0.5 + 0.4 * torch.sin(torch.stack([9 * x[:, 0], 11 * x[:, 1], 7 * x.sum(1)], dim=1))
    error = (seen_colors(video, body) - true).abs().mean()
    assert error < 0.4 * (true - true.mean(0)).abs().mean()


def test_a_side_that_is_never_seen_has_the_mean_color(video, body):
    front = type(video)(**{**vars(video), "splits": Splits([0], [])})
    colors = seen_colors(front, body)
    behind = vertex_normals(body.v_template, body.faces)[:, 2] < -0.95
    assert colors.isfinite().all()
    assert len(torch.unique(colors[behind], dim=0)) < 0.1 * int(behind.sum())


def test_test_frames_are_not_used(video, body):
    before = seen_colors(video, body)
    fewer = type(video)(**{**vars(video), "splits": Splits(video.splits.train, [])})
    assert torch.equal(seen_colors(fewer, body), before)
