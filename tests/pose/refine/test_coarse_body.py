"""The body on fewer triangles is the same body."""

import numpy as np
import pytest
import torch

from gva_mi.mesh.surface import CoarseBody
from gva_mi.refine.close_ups import parts_of
from gva_mi.refine.sequence import SequenceOptions

FACES = SequenceOptions.faces


@pytest.fixture(scope="module")
def coarse(body):
    return CoarseBody(body, FACES)


def test_vertices_are_those_of_the_body_in_every_pose(coarse, body, clip):
    found, whole = coarse.body(clip.pose, clip.shape), body(clip.pose, clip.shape)
    assert torch.equal(found.vertices, whole.vertices[:, coarse.kept])
    assert torch.equal(found.joints, whole.joints)


def test_it_is_closed(coarse):
    """Every edge has a triangle on both sides, in opposite directions."""
    faces = coarse.body.faces.numpy()
    assert len(faces) == FACES and len(np.unique(faces)) == len(coarse.kept)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    directed = {tuple(edge) for edge in edges.tolist()}
    assert len(directed) == len(edges)
    assert {(b, a) for a, b in directed} == directed


def test_a_displacement_is_extended_smoothly(coarse, body):
    """It agrees on the kept vertices, and a linear function stays linear in between."""
    ramp = lambda x: 0.01 * x @ torch.tensor([[1.0, 0.2, 0], [0, 1, 0.3], [0.1, 0, 1]])
    spread = coarse.spread(ramp(coarse.body.v_template))
    expected = ramp(body.v_template)
    assert torch.allclose(spread[coarse.kept], expected[coarse.kept], atol=1e-5)
    assert float((spread - expected).norm(dim=1).mean()) < 2e-4  # a hundredth of the ramp's rise


def test_hands_and_feet_keep_more_triangles_for_close_ups(coarse, body):
    parts = parts_of(body)
    finer = CoarseBody(body, FACES, torch.cat([part.vertices for part in parts]))
    assert len(finer.body.faces) == FACES
    count = lambda of, part: int(torch.isin(of.kept[of.body.faces], part.vertices).all(1).sum())
    assert all(count(finer, part) > 2 * count(coarse, part) for part in parts)
