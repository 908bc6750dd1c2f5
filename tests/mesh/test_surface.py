"""Normals and Laplacian of a surface: laws on a ball, of which both are known."""

import pytest
import torch
import trimesh

from gva_mi.mesh.surface import uniform_laplacian, vertex_normals


@pytest.fixture(scope="module", params=[torch.float32, torch.float64])
def ball(request):
    mesh = trimesh.creation.icosphere(subdivisions=3)
    return torch.tensor(mesh.vertices, dtype=request.param), torch.tensor(mesh.faces)


def test_normals_of_a_ball_point_from_its_centre(ball):
    vertices, faces = ball
    normals = vertex_normals(vertices, faces)
    assert normals.dtype == vertices.dtype
    tight = torch.finfo(vertices.dtype).eps * 8
    torch.testing.assert_close(
        normals.norm(dim=1), torch.ones(len(vertices)).to(normals), rtol=tight, atol=0
    )
    assert (normals * vertices).sum(1).min() > 0.999


def test_laplacian_of_a_constant_is_zero_and_of_a_ball_points_outwards(ball):
    vertices, faces = ball
    L = uniform_laplacian(faces.numpy(), len(vertices))
    assert torch.sparse.mm(L, torch.ones(len(vertices), 3)).abs().max() < 1e-6
    assert (torch.sparse.mm(L, vertices.float()) * vertices.float()).sum(1).min() > 0
