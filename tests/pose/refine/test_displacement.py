"""The energy of the clothes' displacement."""

import pytest
import torch

from gva_mi.body.face import face_shares
from gva_mi.body.smplx import Rest
from gva_mi.mesh.surface import vertex_normals
from gva_mi.refine import sequence
from gva_mi.refine.sequence import Displacement


@pytest.fixture(scope="module")
def cloth(body):
    return Displacement(body.v_template, body.faces, torch.zeros(len(body.v_template)))


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


def test_bare_parts_stay_and_the_edge_of_the_face_follows_by_its_share(body):
    face = face_shares(Rest(body.v_template, body.j_template), body.weights)
    cloth = Displacement(body.v_template, body.faces, face)
    with torch.no_grad():
        cloth.raw.fill_(1.0)
    assert (face == 1).any() and not cloth.offsets[face == 1].any()
    assert ((face > 0) & (face < 1)).any() and torch.equal(cloth.offsets[:, 0], 1 - face)


def test_a_body_without_eyes_has_no_face(body):
    joints = torch.zeros_like(body.j_template)
    assert not face_shares(Rest(body.v_template, joints), body.weights).any()
