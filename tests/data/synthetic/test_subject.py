"""People of different seeds, dressed and bare."""

import numpy as np
import pytest
import torch

from gva_mi.body.smplx import load_body
from gva_mi.data.synthetic.garments import BodySurface
from gva_mi.data.synthetic.subject import draw_subject, vertex_normals
from gva_mi.data.synthetic.texture import Part


@pytest.fixture(scope="module")
def body():
    return load_body()


@pytest.fixture(scope="module")
def dressed(body):
    return draw_subject(body, 1)


def test_a_bare_subject_is_the_body_itself(body):
    bare = draw_subject(body, 0, clothes=False, hairy=False)
    rest = body.rest(bare.shape).vertices.numpy()
    assert np.allclose(bare.vertices, rest, atol=1e-6)
    assert np.array_equal(bare.faces, body.faces.numpy())
    assert set(bare.part) == {int(Part.SKIN)}


def test_another_seed_is_another_person(body):
    a, b, again = (draw_subject(body, k, clothes=False, hairy=False) for k in (0, 1, 0))
    assert not torch.allclose(a.shape.betas, b.shape.betas)
    assert a.look != b.look
    assert np.array_equal(a.vertices, again.vertices) and a.look == again.look


@pytest.mark.slow
def test_clothes_lie_outside_the_body(body, dressed):
    rest = body.rest(dressed.shape).vertices.double().numpy()
    faces = body.faces.numpy()
    surface = BodySurface(rest, faces, vertex_normals(rest, faces))
    cloth = np.unique(dressed.faces[dressed.part != int(Part.SKIN)])
    lit = cloth[dressed.tint[cloth, 0] > 0.98]  # openings reach inwards, and are dark
    distance = surface.distance(dressed.vertices[lit].astype(float))
    assert (distance > -0.002).mean() > 0.99
    assert np.median(distance) > 0.008


@pytest.mark.slow
def test_every_part_is_closed_and_skins_with_the_body(dressed):
    import trimesh

    assert set(dressed.part) == {int(p) for p in Part}
    for part in set(Part) - {Part.SKIN}:
        faces = dressed.faces[dressed.part == int(part)]
        mesh = trimesh.Trimesh(dressed.vertices, faces, process=False)
        mesh.remove_unreferenced_vertices()
        assert mesh.is_watertight and mesh.volume > 0, part
    assert torch.allclose(dressed.weights.sum(1), torch.ones(len(dressed.weights)), atol=1e-5)
    assert (dressed.weights >= 0).all()
