"""Bodies that the fitted one does not span, and the ground truth on the fitted body."""

import numpy as np
import pytest
import torch

from gva_mi.body.pose import JOINTS, PARENTS, Pose, Shape
from gva_mi.body.smplx import load_body
from gva_mi.synthetic.errors.closest_pose import LIMBS, closest
from gva_mi.synthetic.motion.motions import perform
from gva_mi.synthetic.person.bodies import BodyStretch, stretched

AVERAGE = Shape(torch.zeros(10))


@pytest.fixture(scope="module")
def other(body):
    stretch = BodyStretch.draw(np.random.default_rng(0))
    return stretch, stretched(body, stretch)


def test_without_a_stretch_it_is_the_body_itself(body):
    same = stretched(body, BodyStretch(*[dict.fromkeys(JOINTS, 1.0)] * 2))
    pose = Pose.rest(1)
    pose.rotations[:] = 0.3 * torch.sin(torch.arange(165.0)).reshape(1, 55, 3)
    shape = Shape(torch.linspace(-1, 1, 10))
    for part in ("vertices", "joints"):
        a, b = (getattr(x(pose, shape), part) for x in (body, same))
        assert (a - b).abs().max() < 2e-6  # metres


def test_segments_have_the_given_lengths(body, other):
    stretch, figure = other
    joints, usual = figure.rest(AVERAGE).joints, body.rest(AVERAGE).joints
    for k, name in enumerate(JOINTS):
        if name.endswith(("knee", "ankle", "elbow", "wrist")):
            parent = PARENTS[k]
            bones = ((x[k] - x[parent]).norm() for x in (joints, usual))
            assert abs(next(bones) / next(bones) - stretch.length[JOINTS[parent]]) < 0.004


def test_the_surface_stays_closed_and_no_face_turns_over(body, other):
    import trimesh

    before, after = (
        trimesh.Trimesh(x.rest(AVERAGE).vertices.numpy(), x.faces.numpy(), process=False)
        for x in (body, other[1])
    )
    assert after.is_watertight and after.is_winding_consistent
    assert 0.8 < after.volume / before.volume < 1.25
    assert (before.face_normals * after.face_normals).sum(1).min() > 0


@pytest.fixture(scope="module")
def truth():
    pose = perform("everyday", np.linspace(0, 0.9, 3), None, 10, np.random.default_rng(0))
    betas = np.random.default_rng(1).normal(0, 0.7, 10)
    return pose, Shape(torch.from_numpy(betas).float())


def test_a_person_in_the_span_is_found_exactly(body, truth):
    same = closest(body, body, *truth)
    assert same.pose is truth[0] and same.shape is truth[1] and same.joint_mm == 0
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


def test_same_bits_for_any_number_of_threads(body, other, truth):
    before, found = torch.get_num_threads(), []
    for threads in (1, 2):
        torch.set_num_threads(threads)
        near = closest(body, other[1], *truth)
        found.append((near.pose.rotations, near.pose.transl, near.shape.betas))
    torch.set_num_threads(before)
    assert all(torch.equal(a, b) for a, b in zip(*found, strict=True))
