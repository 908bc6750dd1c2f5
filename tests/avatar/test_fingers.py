"""Gaussians of fingers stay on the fingers."""

import copy

import torch

from gva_mi.avatar.fingers import REACH, Fingers, finger_weights


def test_gaussians_of_fingers_come_back_and_all_others_stay(known):
    avatar = copy.deepcopy(known)
    G, body = avatar.canonical, avatar.rig.vertices[finger_weights(avatar.rig.weights) > 0.5]
    finger = finger_weights(G.weights) > 0.5
    assert finger.any() and (~finger).any()
    with torch.no_grad():
        G.means[::2] += 0.02
    before = G.means.detach().clone()
    off = lambda means: (means[finger][:, None] - body).norm(dim=2).amin(1)
    far = off(before) > REACH
    assert far.any() and (~far).any()
    Fingers(avatar.rig).hold(avatar)
    assert off(G.means.detach()).max() < REACH + 1e-6
    torch.testing.assert_close(G.means[finger][~far], before[finger][~far])
    assert torch.equal(G.means[~finger], before[~finger])
