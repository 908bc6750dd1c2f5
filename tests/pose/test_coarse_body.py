"""The body on fewer triangles is the same body."""

import numpy as np
import pytest
import torch

from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.pose.close_ups import parts_of
from gva_mi.pose.coarse_body import CoarseBody
from gva_mi.pose.evidence import MaskAndNormals

FACES = 6000


@pytest.fixture(scope="module")
def coarse(body):
    return CoarseBody(body, FACES)


def test_vertices_are_those_of_the_body_in_every_pose(coarse, body, clip):
    whole = body(clip.pose, clip.shape).vertices[:, coarse.kept]
    assert torch.equal(coarse.body(clip.pose, clip.shape).vertices, whole)
    assert torch.equal(
        coarse.body(clip.pose, clip.shape).joints, body(clip.pose, clip.shape).joints
    )


def test_it_is_closed_where_the_body_is(coarse, body):
    """Every edge has a triangle on both sides, in opposite directions."""
    faces = coarse.body.faces.numpy()
    assert len(faces) == FACES and len(np.unique(faces)) == len(coarse.kept)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    directed = {tuple(edge) for edge in edges.tolist()}
    assert len(directed) == len(edges)
    assert {(b, a) for a, b in directed} == directed


def test_it_looks_the_same(coarse, body, clip):
    """Within one in a hundred of the loss of a picture that shows another pose."""
    outline = next(clip.outlines([1]))
    losses = []
    for model in (body, coarse.body):
        vertices = model(clip.pose[0:1], clip.shape).vertices[0]
        seen = MaskAndNormals.of(outline, 1, body(clip.pose[0:1], clip.shape).vertices[0])
        image = MeshScene(model.faces, vertices).render(vertices, seen.camera)
        losses.append(float(seen.loss(image, silhouette=1.0)))
    assert losses[1] == pytest.approx(losses[0], rel=0.02)


def test_the_same_twice(coarse, body):
    again = CoarseBody(body, FACES)
    assert torch.equal(again.kept, coarse.kept)
    assert torch.equal(again.body.faces, coarse.body.faces)


def test_a_small_body_stays_as_it_is(body):
    whole = CoarseBody(body, len(body.faces))
    assert whole.body is body
    offsets = torch.ones_like(body.v_template)
    assert whole.spread(offsets) is offsets


def test_a_displacement_is_spread_without_bends(coarse, body):
    """It agrees on the common vertices; what is linear in the place stays so in between."""
    ramp = lambda x: 0.01 * x @ torch.tensor([[1.0, 0.2, 0], [0, 1, 0.3], [0.1, 0, 1]])
    spread = coarse.spread(ramp(coarse.body.v_template))
    expected = ramp(body.v_template)
    assert torch.allclose(spread[coarse.kept], expected[coarse.kept], atol=1e-5)
    assert float((spread - expected).norm(dim=1).mean()) < 2e-4  # a hundredth of the ramp's rise


def test_what_close_ups_show_keeps_more_triangles(coarse, body):
    parts = parts_of(body)
    finer = CoarseBody(body, FACES, torch.cat([part.vertices for part in parts]))
    assert len(finer.body.faces) == FACES
    count = lambda of, part: int(torch.isin(of.kept[of.body.faces], part.vertices).all(1).sum())
    for part in parts:
        assert count(finer, part) > 2 * count(coarse, part)
