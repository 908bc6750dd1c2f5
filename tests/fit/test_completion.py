"""Colours of what no frame shows come from around it, and from the other side of the body."""

import copy

import numpy as np
import pytest
import torch
from samples.subjects import write_subject
from torch.nn.functional import normalize

from gva_mi.avatar.held import arm_weights, head_weights
from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.body.skinning import finger_weights
from gva_mi.fit.completion import (
    CONTACT_REACH,
    OPPOSITE_RANGE,
    Places,
    clearance,
    complete_colors,
    guesses,
    neighbours,
)
from gva_mi.fit.samples import FrameSampler
from gva_mi.mesh.surface import vertex_normals
from gva_mi.splat import render
from gva_mi.subject.video import load_video

NOISE = 2.0  # of colours that no frame shows


@pytest.fixture(scope="module")
def alike(known):
    """An avatar with the same colours on the left and on the right, and its normals at rest."""
    avatar = copy.deepcopy(known)
    x, rig = avatar.canonical.means.detach(), avatar.rig
    with torch.no_grad():
        avatar.canonical.sh[:, 0] = torch.sin(
            torch.stack([9 * x[:, 0].abs(), 11 * x[:, 1], 7 * x[:, 2]], dim=1)
        )
    on_body = vertex_normals(rig.vertices, rig.faces)
    return avatar, normalize(avatar.skin.beneath_points(x, on_body), dim=1)


def completed(avatar, hidden, turn, camera, folder):
    """Colours (N, 3) after completion by one frame; before it, those of ``hidden`` are noise."""
    pose = Pose.rest()
    pose.rotations[:, 0, 1] = turn
    video = load_video(write_subject(folder, avatar, camera, pose, Shape(torch.zeros(10))))
    found, generator = copy.deepcopy(avatar), torch.Generator().manual_seed(3)
    with torch.no_grad():
        drawn = torch.randn(int(hidden.sum()), 3, generator=generator)
        found.canonical.sh[hidden, 0] = NOISE * drawn
    complete_colors(found, FrameSampler(video, [0], 0, 16, 0.0), pose)
    return found.canonical.sh.detach()[:, 0]


def test_what_frames_show_stays_and_the_rest_has_the_colors_around_it(alike, camera, tmp_path):
    avatar, n = alike
    colors = completed(avatar, n[:, 2] < -0.6, 0.0, camera, tmp_path)
    shown, back = n[:, 2] > 0.8, (n[:, 2] < -0.6).numpy()
    assert (colors - avatar.canonical.sh[:, 0])[shown].abs().median() < 0.02
    places = Places.of(avatar, n)
    a, back = neighbours(places), back & places.limbs & ~places.arms
    means = a @ colors.double().numpy() / a.sum(1)[:, None]
    assert np.abs(means - colors.numpy())[back].max() < 1e-3
    assert colors[n[:, 2] < -0.6].abs().max() < 1.1  # of the noise, nothing is left


@pytest.mark.parametrize(("turn", "away", "channels"),
    [pytest.param(torch.pi / 2, (1.0, 0.0, 0.0), [0, 1, 2], id="a mirror"),
    pytest.param(0.0, (0.0, 0.0, -1.0), [1], id="the front at its height")])  # fmt: skip
def test_what_no_frame_shows_takes_the_colors_of_the_other_side(
    turn, away, channels, alike, camera, tmp_path, monkeypatch
):
    avatar, n = alike
    true, away = avatar.canonical.sh.detach()[:, 0], n @ torch.tensor(away)
    there = (away > 0.7) & (avatar.canonical.means[:, 1] < -0.3)  # of the legs
    error = []
    for reach in (OPPOSITE_RANGE, 1e-9):  # with and without the other side
        monkeypatch.setattr("gva_mi.fit.completion.OPPOSITE_RANGE", reach)
        colors = completed(avatar, away > 0.6, turn, camera, tmp_path)
        error.append(float((colors - true)[there][:, channels].abs().mean()))
    assert error[0] < 0.7 * error[1], error


HAIR, SKIN, CLOTH, PRINT = np.eye(4)
ARMS_AT_THE_SIDES = 1.45  # radians below the T-pose


@torch.no_grad()
def test_a_contact_is_where_places_meet_that_lie_apart_at_rest(alike, sharp, hanging):
    avatar, _ = alike
    G = avatar.canonical
    clear = lambda lowered: clearance(avatar(hanging(lowered)), G.means, sharp)
    assert clear(0.0).isinf().all()  # in the T-pose nothing touches
    touching = clear(ARMS_AT_THE_SIDES)
    hand = (finger_weights(G.weights) > 0.5) & (G.means[:, 0] > 0)
    foot = G.weights[:, JOINTS.index("left_foot")] > 0.5
    head = head_weights(G.weights) > 0.5
    assert touching[hand].min() < 0.02  # beside the hip
    assert touching[head].min() > 0.1 and touching[foot].min() > 0.1


@torch.no_grad()
def test_the_opposite_edges_of_a_picture_do_not_touch(alike, sharp, hanging):
    """A picture of the trunk alone is cut by its upper and lower edge, and has no contact."""
    avatar, _ = alike
    means = avatar.canonical.means
    rows = sharp.project(means.double().numpy())[:, 1]
    top, bottom = int(np.quantile(rows, 0.3)), int(np.quantile(rows, 0.9))
    cut = sharp.cropped(0, top, sharp.width, bottom - top)
    alpha = render(avatar(hanging(0.0)), cut).alpha
    assert alpha[0].max() > 0.9 and alpha[-1].max() > 0.9
    assert clearance(avatar(hanging(0.0)), means, cut).isinf().all()


def test_an_arm_on_the_trunk_keeps_no_colors_of_the_contact(
    alike, sharp, hanging, tmp_path, monkeypatch
):
    """The true colour of arms is that of their outer sides; the inner ones have another one."""
    avatar, _ = alike
    G, pose = avatar.canonical, hanging(ARMS_AT_THE_SIDES)
    arm = (arm_weights(G.weights) > 0.9) & (finger_weights(G.weights) < 0.1)
    video = load_video(write_subject(tmp_path, avatar, sharp, pose, Shape(torch.zeros(10))))
    samples = FrameSampler(video, [0], 0, 16, 0.0)
    with torch.no_grad():
        inner = arm & (clearance(avatar(pose), G.means, sharp) < 0.01)
    error = []
    for reach in (CONTACT_REACH, 1e-9):  # and without contacts
        monkeypatch.setattr("gva_mi.fit.completion.CONTACT_REACH", reach)
        found = copy.deepcopy(avatar)
        with torch.no_grad():
            found.canonical.sh[arm] = 0.0
            found.canonical.sh[inner, 0] = NOISE
        complete_colors(found, samples, pose)
        error.append(float(found.canonical.sh.detach()[inner, 0].abs().mean()))
    assert inner.sum() > 10
    assert error[0] < 0.7 * error[1], error


def test_a_back_that_no_frame_shows_has_hair_and_no_print(alike):
    """The front of a head is hair above skin, that of the trunk a print on cloth."""
    places = Places.of(*alike)
    x, y = places.points[:, 0], places.points[:, 1]
    head, front = ~places.trunk & ~places.limbs, places.normals[:, 2] > 0
    hairline = np.quantile(y[places.skull & front], 0.8)
    printed = places.trunk & (np.abs(x) < 0.05) & (np.abs(y - np.median(y[places.trunk])) < 0.1)
    f = np.where(head[:, None], np.where(y[:, None] > hairline, HAIR, SKIN), CLOTH)
    f[printed] = PRINT
    h, b = guesses(places, np.where(front, 1.0, 1e-7), np.where(front[:, None], f, 9.0))
    guessed = ~front & (b > 0.1)  # what no frame shows at any height is not
    assert (places.skull & guessed).any() and (places.trunk & guessed & printed).any()
    assert np.abs(h[places.skull & guessed] - HAIR).max() < 1e-4
    assert (h[places.trunk & guessed] == CLOTH).all()
    assert not b[places.limbs & ~places.arms].any() and not b[head & front].any()
