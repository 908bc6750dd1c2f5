"""Gaussians stay near the body and its clothes, those of fingers and armpits most of all."""

import copy

import pytest
import torch

from gva_mi.avatar.held import (
    ARMPIT_REACH,
    BARE_REACH,
    BODY_REACH,
    FINGER_REACH,
    HAIR_REACH,
    MAX_THICKNESS,
    Held,
    arm_weights,
    head_weights,
    shared_weights,
)
from gva_mi.body.face import face_shares
from gva_mi.body.pose import JOINTS
from gva_mi.body.skinning import finger_weights
from gva_mi.body.smplx import Rest
from gva_mi.mesh.surface import vertex_normals
from gva_mi.splat.reference import rotation


@pytest.fixture
def moved(known):
    """An avatar of which every other Gaussian has left the body by 20 mm, and the means before."""
    avatar = copy.deepcopy(known)
    with torch.no_grad():
        avatar.canonical.means[::2] += 0.02
    return avatar, avatar.canonical.means.detach().clone()


def _off(means, vertices):
    """Return distances (N,) from the nearest vertices, and these."""
    return (means[:, None] - vertices).norm(dim=2).min(1)


def test_gaussians_of_fingers_come_back(moved):
    avatar, before = moved
    G, body = avatar.canonical, avatar.rig.vertices[finger_weights(avatar.rig.weights) > 0.5]
    finger = finger_weights(G.weights) > 0.5
    far = _off(before[finger], body)[0] > FINGER_REACH
    assert far.any() and (~far).any()
    Held(avatar.rig).hold(avatar, body=False)
    assert _off(G.means.detach()[finger], body)[0].max() < FINGER_REACH + 1e-6
    torch.testing.assert_close(G.means[finger][~far], before[finger][~far])


def test_gaussians_in_armpits_come_back_unless_clothes_are_loose(known):
    avatar = copy.deepcopy(known)
    rig, G = avatar.rig, avatar.canonical
    beneath = rig.vertices + 0.03 * vertex_normals(rig.vertices, rig.faces)
    nearest = _off(beneath, rig.vertices)[1]
    armpit = int((_armpit(rig) & (nearest == torch.arange(len(nearest)))).nonzero()[0, 0])
    with torch.no_grad():
        G.means[0], G.weights[0] = beneath[armpit], rig.weights[armpit]
    off = lambda: (G.means[0].detach() - rig.vertices[armpit]).norm().item()
    rig.looseness[:] = 0.08
    Held(rig).hold(avatar, body=False)
    assert off() == pytest.approx(0.03, abs=1e-6)
    rig.looseness[:] = 0.0
    Held(rig).hold(avatar, body=False)
    assert off() == pytest.approx(ARMPIT_REACH, abs=1e-6)


def test_all_other_gaussians_keep_their_bits(moved):
    avatar, before = moved
    G = avatar.canonical
    Held(avatar.rig).hold(avatar, body=False)
    free = (finger_weights(G.weights) <= 0.5) & (shared_weights(G.weights) == 0)
    assert free.any()
    assert torch.equal(G.means[free], before[free])


@pytest.mark.parametrize("looseness", [0.0, 0.01])
def test_all_gaussians_come_back_to_clothes_that_are_known(known, looseness):
    avatar = copy.deepcopy(known)
    rig, G = avatar.rig, avatar.canonical
    rig.looseness[:] = looseness
    with torch.no_grad():
        G.means[::2] *= 1.2
    before = G.means.detach().clone()
    Held(rig).hold(avatar, body=True)
    free = (finger_weights(G.weights) <= 0.5) & (shared_weights(G.weights) == 0)
    was, now = (_off(means[free], rig.vertices)[0] for means in (before, G.means.detach()))
    head = head_weights(rig.weights)[_off(before[free], rig.vertices)[1]] > 0.5
    reach = looseness + torch.where(head, HAIR_REACH, BODY_REACH)
    far = was > reach
    assert far.any() and (~far).any()
    assert torch.equal(G.means[free][~far], before[free][~far])
    if looseness:
        assert (now < reach + 1e-6).all() and head.any() and (~head).any()
    else:
        assert torch.equal(now, was)


def test_gaussians_lie_flat_on_the_body(known):
    avatar = copy.deepcopy(known)
    G, rig = avatar.canonical, avatar.rig
    normals = vertex_normals(rig.vertices, rig.faces)[_off(G.means.detach(), rig.vertices)[1]]
    with torch.no_grad():
        G.log_scales[::2] += 3  # discs of the seeds become thick
        G.log_scales[1::4, 0] += 1
        G.quats += 0.3 * torch.randn(G.quats.shape, generator=torch.Generator().manual_seed(0))
    before = G.log_scales.detach().clone()
    was = _along(G, normals)
    held = Held(rig)
    held.hold(avatar, body=False)
    assert torch.equal(G.log_scales, before)
    for _ in range(60):
        held.hold(avatar, body=True)
    assert (was > MAX_THICKNESS).any() and (was < MAX_THICKNESS).any()
    assert _along(G, normals).max() < 1.01 * MAX_THICKNESS
    assert torch.equal(G.log_scales[was < MAX_THICKNESS], before[was < MAX_THICKNESS])


def _along(G, normals):
    """Return the standard deviations (N,) of Gaussians along normals (N, 3)."""
    axes = torch.stack([rotation(q) for q in G.quats.detach()])
    S = axes @ torch.diag_embed(G.scales.detach().square()) @ axes.mT
    return (normals[:, None] @ S @ normals[..., None]).flatten().sqrt()


def _armpit(rig):
    """Return which vertices of the body lie under the left arm, (V,) bool, by their place."""
    shoulder, elbow = rig.joints[[JOINTS.index("left_shoulder"), JOINTS.index("left_elbow")]]
    x, y, _ = rig.vertices.unbind(1)
    near = (x > shoulder[0] - 0.02) & (x < (shoulder + elbow)[0] / 2) & (y < shoulder[1] - 0.04)
    return near & (shared_weights(rig.weights) > 0.1)


def test_bare_arms_are_held_closest_and_clothes_are_not(known):
    farthest = {}
    for given in (True, False):
        avatar = copy.deepcopy(known)
        rig, G = avatar.rig, avatar.canonical
        rig.looseness[:] = 0.01
        rig.looseness[arm_weights(rig.weights) > 0.5] = 0.0
        arm = (arm_weights(G.weights) > 0.5) & (finger_weights(G.weights) <= 0.5)
        with torch.no_grad():
            G.means[::2] *= 1.2
        Held(rig, torch.ones(len(rig.vertices)) if given else None).hold(avatar, body=True)
        off, nearest = _off(G.means.detach()[arm], rig.vertices)
        farthest[given] = off[rig.looseness[nearest] == 0].max()
    assert farthest[True] < BARE_REACH + 1e-6 and farthest[False] > BARE_REACH + 1e-3


def test_gaussians_of_a_skirt_may_stand_off_it_as_far_as_pictures_tell_its_clothes(known):
    loose, thighs = 0.05, [JOINTS.index(k) for k in ("left_hip", "right_hip")]
    for told in (1.0, 0.5, 0.0):
        avatar = copy.deepcopy(known)
        rig, G = avatar.rig, avatar.canonical
        rig.looseness[:] = loose
        skirt, mine = (x.weights[:, thighs].sum(1) > 0.9 for x in (rig, G))
        with torch.no_grad():
            G.means[mine, 2] += 0.2
        Held(rig, torch.where(skirt, told, 1.0)).hold(avatar, body=True)
        off, nearest = _off(G.means.detach()[mine], rig.vertices)
        assert abs(off[skirt[nearest]].max() - (told * loose + BODY_REACH)) < 1e-3


def test_gaussians_of_a_video_s_face_stay_nearer_than_those_of_its_hair(known):
    farthest = {}
    for given in (True, False):
        avatar = copy.deepcopy(known)
        rig, G = avatar.rig, avatar.canonical
        rig.looseness[:] = 0.005
        shares = face_shares(Rest(rig.vertices, rig.joints), rig.weights)
        face, hair = shares == 1, (shares == 0) & (head_weights(rig.weights) > 0.5)
        mine = head_weights(G.weights) > 0.5
        with torch.no_grad():
            G.means[mine, 2] += 0.2 * torch.sign(G.means[mine, 2])
        Held(rig, torch.ones(len(rig.vertices)) if given else None).hold(avatar, body=True)
        off, nearest = _off(G.means.detach()[mine], rig.vertices)
        farthest[given] = float(off[face[nearest]].max()), float(off[hair[nearest]].max())
    reach = lambda x: pytest.approx(0.005 + x, abs=1e-3)
    assert farthest[True] == (reach(BODY_REACH), reach(HAIR_REACH))
    assert farthest[False] == (reach(HAIR_REACH), reach(HAIR_REACH))
