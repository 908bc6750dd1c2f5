"""Ground truth on the fitted body: exact for a person within its span."""

import numpy as np
import pytest
import torch

from gva_mi.body.pose import Shape
from gva_mi.body.smplx import load_body
from gva_mi.synthetic.closest import LIMBS, closest
from gva_mi.synthetic.motion import perform
from gva_mi.synthetic.stretched import BodyStretch, stretched


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
