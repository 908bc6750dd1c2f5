"""Surfaces around Gaussians join neither the legs nor arms and trunk."""

import numpy as np
import pytest
import torch

from gva_mi.avatar.reinit import ReinitOptions, mesh_gaussians
from gva_mi.avatar.rig import Rig
from gva_mi.avatar.surface import SPREAD_ANGLE, SpreadLimbs
from gva_mi.body.pose import JOINTS, Shape

STILL = [JOINTS.index(name) for name in ("pelvis", "spine1", "spine2", "spine3", "neck", "head")]
LEG = ("hip", "knee", "ankle", "foot")


@pytest.fixture(scope="module")
def rig(built_in_body):
    return Rig.of(built_in_body, Shape(torch.zeros(10)))


def test_a_surface_ends_between_the_legs_where_the_body_does(rig):
    points, hip = rig.vertices.double().numpy(), rig.joints[JOINTS.index("left_hip")].numpy()
    surface = mesh_gaussians(points, rig, ReinitOptions())
    between = lambda x: x[(np.abs(x[:, 0]) < 0.01) & (x[:, 1] < hip[1]), 1].min()
    assert between(surface.vertices) == pytest.approx(between(points), abs=0.02)  # a web: 0.10


def test_legs_turn_about_their_hips_and_the_trunk_stays(rig):
    points, weights = rig.vertices.double().numpy(), rig.weights.double().numpy()
    spread, hip = SpreadLimbs.of(rig, points, weights), JOINTS.index("left_hip")
    of_legs = lambda side: weights[:, [JOINTS.index(f"{side}_{name}") for name in LEG]].sum(1)
    trunk, leg = weights[:, STILL].sum(1) > 1 - 1e-6, of_legs("left") > 1 - 1e-6
    assert trunk.any() and np.allclose(spread.points[trunk], points[trunk], atol=1e-12)
    c, s = np.cos(SPREAD_ANGLE), np.sin(SPREAD_ANGLE)
    at = rig.joints[hip].double().numpy()
    turned = (points[leg] - at) @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + at
    assert leg.any() and np.allclose(spread.points[leg], turned, atol=1e-6)
