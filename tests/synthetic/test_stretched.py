"""Stretched bodies: segments of given length, a closed surface, the same meaning of betas."""

import numpy as np
import pytest
import torch

from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.synthetic.stretched import BodyStretch, stretched

AVERAGE = Shape(torch.zeros(10))


@pytest.fixture(scope="module")
def other(body):
    stretch = BodyStretch.draw(np.random.default_rng(0))
    return stretch, stretched(body, stretch)


def length(body, a, b):
    joints = body.rest(AVERAGE).joints
    return float((joints[JOINTS.index(a)] - joints[JOINTS.index(b)]).norm())


def test_strength_zero_is_the_body_itself(body):
    same = stretched(body, BodyStretch.draw(np.random.default_rng(0), strength=0.0))
    pose = Pose.rest(1)
    pose.rotations[:] = 0.3 * torch.sin(torch.arange(165.0)).reshape(1, 55, 3)
    shape = Shape(torch.linspace(-1, 1, 10))
    for part in ("vertices", "joints"):
        a, b = (getattr(x(pose, shape), part) for x in (body, same))
        assert (a - b).abs().max() < 2e-6  # metres


def test_segments_have_the_given_lengths(body, other):
    stretch, figure = other
    for a, b in (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist")):
        for side in ("left", "right"):
            long, usual = (length(x, f"{side}_{a}", f"{side}_{b}") for x in (figure, body))
            assert abs(long / usual - stretch.length[f"{side}_{a}"]) < 0.004


def test_the_surface_stays_closed_and_no_face_turns_over(body, other):
    import trimesh

    before, after = (
        trimesh.Trimesh(x.rest(AVERAGE).vertices.numpy(), x.faces.numpy(), process=False)
        for x in (body, other[1])
    )
    assert after.is_watertight and after.is_winding_consistent
    assert 0.8 < after.volume / before.volume < 1.25
    assert (before.face_normals * after.face_normals).sum(1).min() > 0


def test_a_restricted_body_is_refused(body):
    part = body.on(torch.arange(10), body.faces[:0])
    with pytest.raises(ValueError, match="part of a body"):
        stretched(part, BodyStretch.draw(np.random.default_rng(0)))
