"""Creases and lags: smooth, bounded, and zero at rest."""

import numpy as np
import pytest

from gva_mi.body.pose import JOINTS
from gva_mi.synthetic.clothes import folds

JOINT_POSITIONS = dict(zip(JOINTS, np.random.default_rng(0).normal(0, 0.4, (55, 3)), strict=True))


@pytest.fixture
def creases():
    rng = np.random.default_rng(1)
    points = rng.normal(0, 0.4, (4000, 3))
    return folds.creases(points, np.full(4000, 0.005), JOINT_POSITIONS, rng)


def test_a_straight_joint_and_a_twist_have_no_creases(creases):
    for crease in creases:
        assert not crease.displacement(np.zeros(3)).any()
        assert np.abs(crease.displacement(crease.bone * 0.8)).max() < 1e-12


def test_creases_grow_with_the_bend_and_are_deeper_inside(creases):
    crease = next(c for c in creases if c.joint == JOINTS.index("left_elbow"))
    bend = np.cross(crease.bone, [0.3, 0.5, 0.8])
    bend /= np.linalg.norm(bend)
    sizes = [np.abs(crease.displacement(angle * bend)).sum() for angle in (0.2, 0.6, 1.5)]
    assert sizes[0] < sizes[1] < sizes[2]
    inner = crease.around @ np.cross(bend, crease.bone) > 0
    depth = np.abs(crease.displacement(bend)) / np.maximum(np.abs(crease.height), 1e-12)
    assert depth[inner].mean() > 2 * depth[~inner].mean()
    assert np.abs(crease.displacement(1.5 * bend)).max() <= 0.005


def test_loose_ends_lag_behind_motion_and_not_at_rest():
    now = np.random.default_rng(0).normal(size=(50, 3))
    away = np.tile([0.0, 1.0, 0.0], (50, 1))
    slack = np.linspace(0.001, 0.03, 50)
    still = np.broadcast_to(now, (folds.MEMORY, 50, 3))
    assert np.abs(folds.lag(now, still, slack, away)).max() < 1e-12
    steps = np.arange(1, folds.MEMORY + 1)[:, None, None]
    moved = folds.lag(now, now - steps * [0.01, 0, 0], slack, away)
    assert (moved[:, 0] < 0).all() and np.abs(moved[:, 1:]).max() < 1e-12
    assert (np.linalg.norm(moved, axis=1) <= slack).all()
    assert (np.diff(-moved[:, 0]) > 0).all()  # the looser, the farther
