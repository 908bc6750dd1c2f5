"""The energy of the displacement for clothes."""

import pytest
import torch

from gva_mi.body.pose import JOINTS
from gva_mi.pose.displacement import Displacement, hand_vertices, vertex_normals


@pytest.fixture(scope="module")
def cloth(body):
    return Displacement(body.v_template, body.faces, body.weights)


def test_nothing_costs_nothing(cloth):
    assert float(cloth.energy(cloth.offsets.detach(), 1.0, 1.0, 1.0)) == 0


def test_a_shift_is_smooth_and_a_bump_is_not(cloth, body):
    shift = torch.full_like(body.v_template, 0.01)
    assert float(cloth.energy(shift, 1.0, 0.0, 0.0)) < 1e-12
    bump = torch.zeros_like(shift)
    bump[100] = 0.01
    assert float(cloth.energy(bump, 1.0, 0.0, 0.0)) > 1e-9


def test_only_inward_costs_by_the_outward_term(cloth, body):
    normals = vertex_normals(body.v_template, body.faces)
    assert float(cloth.energy(0.01 * normals, 0.0, 0.0, 1.0)) == 0
    assert float(cloth.energy(-0.01 * normals, 0.0, 0.0, 1.0)) == pytest.approx(1e-4, rel=1e-3)


def test_hands_stay_bare(cloth, body):
    with torch.no_grad():
        cloth.raw.fill_(1.0)
    hands = hand_vertices(body.weights)
    assert not cloth.offsets[hands].any() and (cloth.offsets[~hands] == 1).all()
    with torch.no_grad():
        cloth.raw.zero_()
    wrists = body.j_template[[JOINTS.index("left_wrist"), JOINTS.index("right_wrist")], 0].abs()
    assert body.v_template[hands, 0].abs().min() > wrists.min() - 0.08


def test_gradient_matches_differences(cloth, body):
    generator = torch.Generator().manual_seed(0)
    x = 0.01 * torch.randn(body.v_template.shape, generator=generator)
    d = torch.randn(x.shape, generator=generator)
    leaf = x.clone().requires_grad_()
    cloth.energy(leaf, 3.0, 2.0, 5.0).backward()
    up, down = (cloth.energy(x + s * 1e-3 * d, 3.0, 2.0, 5.0) for s in (1, -1))
    assert float((leaf.grad * d).sum()) == pytest.approx(float(up - down) / 2e-3, rel=1e-2)
