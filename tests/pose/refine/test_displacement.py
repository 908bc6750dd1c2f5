"""The energy of the clothes' displacement."""

import pytest
import torch

from gva_mi.mesh.surface import vertex_normals
from gva_mi.refine import sequence
from gva_mi.refine.close_ups import hand_vertices
from gva_mi.refine.sequence import Displacement


@pytest.fixture(scope="module")
def cloth(body):
    return Displacement(body.v_template, body.faces, body.weights)


@pytest.fixture
def weights(monkeypatch):
    """Set a, b and c."""

    def set_them(*values):
        for name, value in zip(("SMOOTHNESS", "SMALLNESS", "OUTWARDNESS"), values, strict=True):
            monkeypatch.setattr(sequence, name, value)

    return set_them


def test_zero_costs_nothing_and_a_bump_more_than_a_shift(cloth, body, weights):
    assert float(cloth.energy(cloth.offsets.detach())) == 0
    weights(1.0, 0.0, 0.0)
    shift = torch.full_like(body.v_template, 0.01)
    bump = torch.zeros_like(shift)
    bump[100] = 0.01
    smooth, bent = (float(cloth.energy(x)) for x in (shift, bump))
    assert bent > 0 and smooth < 1e-6 * bent


def test_only_inward_displacement_costs_by_the_outward_term(cloth, body, weights):
    weights(0.0, 0.0, 1.0)
    normals = vertex_normals(body.v_template, body.faces)
    assert float(cloth.energy(0.01 * normals)) == 0
    assert float(cloth.energy(-0.01 * normals)) == pytest.approx(1e-4, rel=1e-3)


def test_hands_stay_bare(body):
    cloth, hands = (Displacement(body.v_template, body.faces, body.weights),
        hand_vertices(body.weights))  # fmt: skip
    with torch.no_grad():
        cloth.raw.fill_(1.0)
    assert hands.any() and not cloth.offsets[hands].any() and (cloth.offsets[~hands] == 1).all()
