"""Bodies that the fitted one does not span, and the ground truth on the fitted body."""

import numpy as np
import pytest
import torch

from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.body.smplx import load_body
from gva_mi.synthetic.foreign_body import LIMBS, BodyStretch, closest, stretched
from gva_mi.synthetic.motion import perform

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


@pytest.fixture(scope="module")
def truth():
    pose = perform("everyday", np.linspace(0, 0.9, 3), None, 10, np.random.default_rng(0))
    betas = np.random.default_rng(1).normal(0, 0.7, 10)
    return pose, Shape(torch.from_numpy(betas).float())


def test_the_same_body_changes_nothing(body, truth):
    found = closest(body, body, *truth)
    assert found.pose is truth[0] and found.shape is truth[1] and found.joint_mm == 0


def test_a_person_in_the_span_is_found_exactly(body, truth):
    found = closest(body, load_body(), *truth)
    assert found.joint_mm < 0.01 and (found.shape.betas - truth[1].betas).abs().max() < 0.002
    assert (found.pose.rotations - truth[0].rotations).abs().max() < 1e-4  # radians
    assert (found.pose.transl - truth[0].transl).abs().max() < 1e-5  # metres
    assert torch.equal(found.pose.expression, truth[0].expression)


def test_another_person_is_matched_at_the_limbs(body, truth):
    figure = stretched(body, BodyStretch.draw(np.random.default_rng(1)))
    found = closest(body, figure, *truth)
    near, true = body(found.pose, found.shape), figure(*truth)
    away = 1000 * (near.joints - true.joints).norm(dim=-1)
    naive = 1000 * (body(*truth).joints - true.joints).norm(dim=-1)
    limbs = list(LIMBS)
    assert away[:, limbs].mean() == pytest.approx(found.limb_mm, abs=0.01)
    assert away.mean() == pytest.approx(found.joint_mm, abs=0.01)
    assert 0.1 < found.limb_mm < 4 and found.limb_mm < naive[:, limbs].mean() / 3  # millimetres


def test_same_bits_for_any_number_of_threads(body, truth):
    other = stretched(body, BodyStretch.draw(np.random.default_rng(3)))
    before, found = torch.get_num_threads(), []
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            near = closest(body, other, *truth)
            found.append((near.pose.rotations, near.pose.transl, near.shape.betas))
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(a, b) for a, b in zip(*found, strict=True))
