"""Subjects, dressed and bare."""

import numpy as np
import pytest
import torch

from gva_mi.body.pose import JOINTS, Pose
from gva_mi.synthetic import STUDY
from gva_mi.synthetic.clothes.level_sets import BodySurface, vertex_normals
from gva_mi.synthetic.look import Material
from gva_mi.synthetic.subject import draw_subject


@pytest.fixture(scope="module")
def dressed(body):
    return draw_subject(body, 1)


def test_a_bare_subject_is_the_body_itself(body):
    bare = draw_subject(body, 0, clothes=False, hair=False)
    rest = body.rest(bare.shape).vertices.numpy()
    assert np.allclose(bare.vertices, rest, atol=1e-6)
    assert np.array_equal(bare.faces, body.faces.numpy())
    assert set(bare.material) == {int(Material.SKIN)}


def test_seeds_define_persons(body):
    a, b, again = (draw_subject(body, k, clothes=False, hair=False) for k in (0, 1, 0))
    assert not torch.allclose(a.shape.betas, b.shape.betas)
    assert a.look != b.look
    assert np.array_equal(a.vertices, again.vertices) and a.look == again.look


@pytest.mark.slow
def test_clothes_lie_outside_the_body(body, dressed):
    rest = body.rest(dressed.shape).vertices.double().numpy()
    faces = body.faces.numpy()
    surface = BodySurface(rest, faces, vertex_normals(rest, faces))
    cloth = np.unique(dressed.faces[dressed.material != int(Material.SKIN)])
    lit = cloth[dressed.tint[cloth, 0] > 0.98]  # dark openings extend inwards
    distance = surface.distance(dressed.vertices[lit].astype(float))
    assert (distance > -0.002).mean() > 0.99
    assert np.median(distance) > 0.008


@pytest.mark.slow
def test_every_piece_is_closed_and_skinned(dressed):
    import trimesh

    assert set(dressed.material) >= {int(p) for p in Material} - {int(Material.ACCESSORY)}
    for part in set(Material) - {Material.SKIN, Material.ACCESSORY}:
        faces = dressed.faces[dressed.material == int(part)]
        mesh = trimesh.Trimesh(dressed.vertices, faces, process=False)
        mesh.remove_unreferenced_vertices()
        assert mesh.is_watertight and mesh.volume > 0, part
    assert torch.allclose(dressed.weights.sum(1), torch.ones(len(dressed.weights)), atol=1e-5)
    assert (dressed.weights >= 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bruno"])
def test_accessories_are_closed_and_move_rigidly_with_the_head(body, name):
    import trimesh

    subject = draw_subject(body, STUDY[name])
    faces = subject.faces[subject.material == int(Material.ACCESSORY)]
    mesh = trimesh.Trimesh(subject.vertices, faces, process=False)
    mesh.remove_unreferenced_vertices()
    assert mesh.is_watertight and mesh.volume > 0
    index = np.unique(faces)
    pose = Pose.rest(1)
    pose.expression[:] = 0.7
    pose.rotations[:, JOINTS.index("jaw"), 0] = 0.2
    pose.rotations[:, JOINTS.index("head"), 1] = 0.4
    moved = subject.posed(body, pose, folds=1.0)[0][index].astype(float)
    rest = subject.vertices[index].astype(float)
    pairs = np.random.default_rng(0).integers(len(index), size=(200, 2)).T
    length = lambda x: np.linalg.norm(x[pairs[0]] - x[pairs[1]], axis=1)
    assert np.abs(length(moved) - length(rest)).max() < 0.001
    assert np.linalg.norm(moved - rest, axis=1).max() > 0.01


@pytest.mark.slow
@pytest.mark.parametrize("name", ["amira"])
def test_long_hair_lies_on_the_shirt_behind_the_shoulders(body, name):
    subject = draw_subject(body, STUDY[name])
    hair, top = (
        np.unique(subject.faces[subject.material == int(m)]) for m in (Material.HAIR, Material.TOP)
    )
    joints = dict(zip(JOINTS, body.rest(subject.shape).joints.numpy(), strict=True))
    low = hair[subject.vertices[hair, 1] < joints["neck"][1]]
    points = subject.vertices[low].astype(float)
    assert len(low) > 300 and points[:, 2].max() < joints["neck"][2] + 0.03
    # Outside the shirt wherever its own outside shows: nothing pokes through.
    shirt = subject.vertices[top].astype(float)
    normals = vertex_normals(subject.vertices.astype(float), subject.faces)
    facing = normals[top]
    for p, n in zip(points[::7], normals[low][::7], strict=True):
        k = np.linalg.norm(shirt - p, axis=1).argmin()
        if n[2] < -0.7:  # seen from behind
            assert (p - shirt[k]) @ facing[k] > 0
