"""Persons, and their surfaces, dressed and bare."""

import copy

import numpy as np
import pytest
import torch

from gva_mi.synthetic.motion import motions
from gva_mi.synthetic.person.identity import SyntheticPerson
from gva_mi.synthetic.person.level_sets import BodySurface, vertex_normals
from gva_mi.synthetic.person.surface import draw_surface
from gva_mi.synthetic.person.texture import Material
from gva_mi.synthetic.pictures.cameras import camera_around
from gva_mi.synthetic.pictures.render import Moment, Renderer


def person(body, seed):
    return SyntheticPerson.draw(seed, body.num_betas)


@pytest.fixture(scope="module")
def dressed(body):
    return draw_surface(body, person(body, 1))


def part(subject, *materials):
    """Return the faces of some materials."""
    return subject.faces[np.isin(subject.material, [int(m) for m in materials])]


def closed(subject, faces):
    import trimesh

    mesh = trimesh.Trimesh(subject.vertices, faces, process=False)
    mesh.remove_unreferenced_vertices()
    return mesh.is_watertight and mesh.volume > 0


def test_a_bare_subject_is_the_body_itself_and_defined_by_its_seed(body):
    bare, other, again = (draw_surface(body, person(body, k), bare=True) for k in (0, 1, 0))
    assert np.allclose(bare.vertices, body.rest(bare.shape).vertices.numpy(), atol=1e-6)
    assert np.array_equal(bare.faces, body.faces.numpy())
    assert set(bare.material) == {int(Material.SKIN)}
    assert not torch.allclose(bare.shape.betas, other.shape.betas) and bare.look != other.look
    assert np.array_equal(bare.vertices, again.vertices) and bare.look == again.look


def test_the_last_surface_is_kept_for_the_same_body(body):
    same, other = copy.deepcopy(body), copy.deepcopy(body)
    other.weights = other.weights.roll(1, dims=0)
    bare = draw_surface(body, person(body, 0), bare=True)
    assert draw_surface(same, person(body, 0), bare=True) is bare
    assert draw_surface(other, person(body, 0), bare=True) is not bare


def test_a_dressed_body_lies_in_its_mask_and_normals_match_the_depth(body, dressed):
    from scipy.ndimage import maximum_filter, minimum_filter

    subject = dressed
    pose = motions.perform("turn", np.array([0.1]), None, 10, np.random.default_rng(0))
    surface = subject.skinned(body, pose)[0]
    camera = camera_around(surface, 96)
    seen = Renderer(subject).expose([Moment(surface, camera)], 4, 0)
    x, y = np.floor(camera.project(body(pose, subject.shape).vertices[0].double().numpy())).T
    assert maximum_filter(seen.mask, 3)[y.astype(int), x.astype(int)].min() > 0
    v, u = np.mgrid[:96, :96] + 0.5
    points = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)])
    along_y, along_x = np.gradient(points * seen.depth, axis=(1, 2))
    normals = np.cross(along_y, along_x, axis=0)
    length = np.maximum(np.linalg.norm(normals, axis=0), 1e-12)
    cosine = (normals / length).transpose(1, 2, 0) * seen.normals
    steep = maximum_filter(seen.depth, 3) - minimum_filter(seen.depth, 3) > 0.05  # m, an outline
    inner = (minimum_filter(seen.mask, 3) == 1) & ~steep
    assert inner.sum() > 500
    assert np.median(cosine.sum(-1)[inner]) > 0.97 and (cosine.sum(-1)[inner] > 0.5).mean() > 0.97


@pytest.mark.slow
def test_clothes_are_closed_and_skinned_and_lie_outside_the_body(body, dressed):
    rest = body.rest(dressed.shape).vertices.double().numpy()
    faces = body.faces.numpy()
    surface = BodySurface(rest, faces, vertex_normals(rest, faces))
    cloth = np.unique(dressed.faces[dressed.material != int(Material.SKIN)])
    lit = cloth[dressed.tint[cloth, 0] > 0.98]  # dark openings extend inwards
    distance = surface.distance(dressed.vertices[lit].astype(float))
    assert (distance > -0.002).mean() > 0.99 and np.median(distance) > 0.008
    for material in set(Material) - {Material.SKIN}:
        assert closed(dressed, part(dressed, material)), material
    assert torch.allclose(dressed.weights.sum(1), torch.ones(len(dressed.weights)), atol=1e-5)
    assert (dressed.weights >= 0).all()
