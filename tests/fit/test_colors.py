"""Colours of the body from the pictures of a video."""

import numpy as np
import torch

from gva_mi.avatar.held import arm_weights
from gva_mi.body.pose import JOINTS, Shape
from gva_mi.fit.colors import BARE_ROWS, CUFF, LIMB_ROW, bare_skin, seen_colors
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


SKIN, CLOTH = torch.tensor([0.8, 0.58, 0.47]), torch.tensor([0.15, 0.3, 0.5])


def _person(body, sleeve):
    """Return colours of a person whose sleeves end at |x| = sleeve, |x| and which are arms."""
    rest = body.rest(Shape(torch.zeros(10)))
    x, arms = rest.vertices[:, 0].abs(), arm_weights(body.weights) > 0.5
    head = body.weights[:, [JOINTS.index(k) for k in ("neck", "head", "jaw")]].sum(1) > 0.5
    colors = torch.where((head | (arms & (x > sleeve)))[:, None], SKIN, CLOTH)
    return colors, x, arms


def test_arms_are_bare_beyond_the_sleeve_in_any_light(body):
    colors, x, arms = _person(body, sleeve=0.4)
    below = vertex_normals(body.v_template, body.faces)[:, 1] < 0
    shaded = torch.where(below[:, None], 0.6, 1.0) * colors
    for seen in (colors, shaded):
        bare = bare_skin(seen, body, Shape(torch.zeros(10)))
        assert (bare[arms & (x > 0.4 + CUFF + LIMB_ROW)] == 1).all()
        assert (bare[arms & (x < 0.4 - LIMB_ROW)] == 0).all()
        assert (bare[~arms] == 0).all()


def test_an_arm_that_a_dress_has_stained_is_bare_and_one_in_gloves_is_not(body):
    colors, x, arms = _person(body, sleeve=0.0)
    stained = arms & (vertex_normals(body.v_template, body.faces)[:, 1] < -0.6)
    colors[stained] = CLOTH
    assert 0.1 < stained.sum() / arms.sum() < 0.4
    bare = bare_skin(colors, body, Shape(torch.zeros(10)))
    assert (bare[arms & (x > 0.3)] == 1).all()
    colors[arms] = CLOTH
    assert not bare_skin(colors, body, Shape(torch.zeros(10)))[arms & (x < 0.6)].any()


def test_a_short_stretch_in_the_color_of_skin_is_a_pattern(body):
    colors, x, arms = _person(body, sleeve=10.0)
    colors[arms & (x > 0.4) & (x < 0.4 + (BARE_ROWS - 2) * LIMB_ROW)] = SKIN
    assert not bare_skin(colors, body, Shape(torch.zeros(10))).any()
