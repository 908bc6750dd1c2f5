"""Colours and clothes of the body from the pictures of a video."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from gva_mi.avatar.held import arm_weights
from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.fit.first_surface import (
    BARE_ROWS,
    CUFF,
    LIMB_ROW,
    LOOSE_CLOTH,
    bare_skin,
    clothes_beside_contacts,
    seen_colors,
)
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


def _turned(camera, turn):
    """Return a video of one frame, turned by so many radians away from the camera."""
    pose = Pose.rest()
    pose.rotations[:, 0, 1] = turn
    return _video(pose, camera)


def _video(pose, camera):
    shape, splits = Shape(torch.zeros(10)), Splits([0], [])
    return SimpleNamespace(pose=pose, cameras=[camera], shape=shape, splits=splits)


@pytest.fixture
def facing(camera):
    return _turned(camera, 0.0)


def _tight(body):
    """Return displacements of clothes that lie on the body."""
    return torch.zeros_like(body.v_template)


def _person(body, sleeve):
    """Return colours of a person whose sleeves end at |x| = sleeve, |x| and which are arms."""
    rest = body.rest(Shape(torch.zeros(10)))
    x, arms = rest.vertices[:, 0].abs(), arm_weights(body.weights) > 0.5
    head = body.weights[:, [JOINTS.index(k) for k in ("neck", "head", "jaw")]].sum(1) > 0.5
    colors = torch.where((head | (arms & (x > sleeve)))[:, None], SKIN, CLOTH)
    return colors, x, arms


def test_arms_are_bare_beyond_the_sleeve_in_any_light(body, facing):
    colors, x, arms = _person(body, sleeve=0.4)
    below = vertex_normals(body.v_template, body.faces)[:, 1] < 0
    shaded = torch.where(below[:, None], 0.6, 1.0) * colors
    for seen in (colors, shaded):
        bare = bare_skin(seen, facing, body, _tight(body))
        assert (bare[arms & (x > 0.4 + CUFF + LIMB_ROW)] == 1).all()
        assert (bare[arms & (x < 0.4 - LIMB_ROW)] == 0).all()
        assert (bare[~arms] == 0).all()


def test_an_arm_that_a_dress_has_stained_is_bare_and_one_in_gloves_is_not(body, facing):
    colors, x, arms = _person(body, sleeve=0.0)
    stained = arms & (vertex_normals(body.v_template, body.faces)[:, 1] < -0.6)
    colors[stained] = CLOTH
    assert 0.1 < stained.sum() / arms.sum() < 0.4
    bare = bare_skin(colors, facing, body, _tight(body))
    assert (bare[arms & (x > 0.3)] == 1).all()
    colors[arms] = CLOTH
    assert not bare_skin(colors, facing, body, _tight(body))[arms & (x < 0.6)].any()


def test_a_short_stretch_in_the_color_of_skin_is_a_pattern(body, facing):
    colors, x, arms = _person(body, sleeve=10.0)
    colors[arms & (x > 0.4) & (x < 0.4 + (BARE_ROWS - 2) * LIMB_ROW)] = SKIN
    assert not bare_skin(colors, facing, body, _tight(body)).any()


def test_a_skirt_in_the_color_of_skin_is_cloth_up_to_the_trunk_and_shins_are_bare(body, facing):
    colors, _, _ = _person(body, sleeve=10.0)
    rest, at = body.rest(Shape(torch.zeros(10))), JOINTS.index
    leg = body.weights[:, [at("left_hip"), at("left_knee"), at("left_ankle")]].sum(1) > 0.7
    knee, y = float(rest.joints[at("left_knee"), 1]), rest.vertices[:, 1]
    colors[leg] = SKIN
    normals = vertex_normals(rest.vertices, body.faces)
    hem = leg & (y > knee + 0.05) & (y < knee + 0.15)  # above it the skirt lies closer
    skirt = torch.where(hem, 2 * LOOSE_CLOTH, 0.01)[:, None] * normals
    bare = bare_skin(colors, facing, body, skirt)
    assert (bare[leg & (y > knee + 0.05 + LIMB_ROW)] == 0).all()
    assert (bare[leg & (y < knee)] == 1).all()


def test_clothes_stay_where_outlines_tell_them_and_give_way_beside_a_contact(sharp, hanging, body):
    """From the front, in a frame in which hands hide the sides of the hips."""
    arms_at_sides = _video(hanging(1.4), sharp)
    normals = vertex_normals(body.v_template, body.faces)
    offsets = 0.01 * normals
    hip = body.weights[:, [JOINTS.index(k) for k in ("left_hip", "pelvis")]].sum(1) > 0.5
    lump = hip & (normals[:, 0] > 0.8)
    calf = (body.weights[:, JOINTS.index("left_knee")] > 0.9) & (normals[:, 0] > 0.9)
    offsets[lump] *= 6  # the hand looks like clothes
    found, told = clothes_beside_contacts(arms_at_sides, body, offsets)
    assert 0 <= told.min() and told.max() <= 1
    assert told[lump].mean() < 0.5 * told[calf].mean()
    found = found.norm(dim=1)
    assert found[lump].median() < 0.6 * offsets[lump].norm(dim=1).median()
    assert (found[calf] - 0.01).abs().median() < 3e-4  # metres
    assert not clothes_beside_contacts(arms_at_sides, body, 0 * offsets)[0].any()


def test_without_the_face_no_limb_is_bare(body, camera):
    """From behind, the face has the colours around it: trousers in the colour of hair stay."""
    colors, _, _ = _person(body, sleeve=10.0)
    colors[:] = SKIN  # all looks alike
    assert bare_skin(colors, _turned(camera, 0.5), body, _tight(body)).any()
    assert not bare_skin(colors, _turned(camera, np.pi), body, _tight(body)).any()
