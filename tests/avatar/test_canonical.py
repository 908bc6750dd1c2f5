"""Seeds lie on the surface, flat in it, evenly, and always the same."""

import pytest
import roma
import torch

from gva_mi.avatar.canonical import (
    BINDING,
    PARAMETERS,
    CanonicalGaussians,
    SeedOptions,
    seed_on_surface,
)
from gva_mi.avatar.rig import Skin
from gva_mi.mesh.surface import vertex_normals


def seed(body, **options):
    skin = Skin(body.v_template, body.weights, torch.arange(642), torch.zeros(642, 3, 0))
    return seed_on_surface(body.v_template, body.faces, skin, SeedOptions(**options))


def distance_to_planes(points, body):
    """Distance of each point to the nearest plane whose triangle it projects into, (N,)."""
    a, b, c = body.v_template[body.faces].unbind(1)
    n = torch.nn.functional.normalize(torch.linalg.cross(b - a, c - a), dim=-1)
    inside = torch.ones(len(points), len(a), dtype=torch.bool)
    for p, q in ((a, b), (b, c), (c, a)):
        edge = torch.linalg.cross(n, q - p)
        inside &= ((points[:, None] - p) * edge).sum(-1) > -1e-5
    height = ((points[:, None] - a) * n).sum(-1).abs()
    return height.where(inside, torch.inf).amin(1)


@pytest.mark.parametrize("count", [300, 642, 1500])
def test_seeds_lie_on_the_surface(body, count):
    G = seed(body, count=count)
    assert len(G) == count
    assert distance_to_planes(G.means.detach(), body).max() < 1e-5


def test_discs_lie_flat_in_the_surface(body):
    G = seed(body, flatness=0.25)
    axes = roma.unitquat_to_rotmat(G.quats[:, [1, 2, 3, 0]].detach())
    normals = vertex_normals(body.v_template, body.faces)
    assert torch.allclose((axes[..., 2] * normals).sum(-1).abs(), torch.ones(len(G)), atol=1e-5)
    assert torch.allclose(G.scales[:, 2] / G.scales[:, 0], torch.tensor(0.25))
    assert torch.equal(G.scales[:, 0], G.scales[:, 1])


def test_blend_shapes_move_as_the_whole_table_says():
    generator = torch.Generator().manual_seed(0)
    directions = torch.randn(6, 3, 5, generator=generator)
    directions[torch.rand(6, 3, 5, generator=generator) < 0.7] = 0
    empty = dict.fromkeys((*PARAMETERS, *BINDING), torch.zeros(6, 3))
    G = CanonicalGaussians(**empty | {"directions": directions})
    for count in (5, 2, 0):  # coefficients that are missing count as zero
        c = torch.randn(count, generator=generator)
        torch.testing.assert_close(G.moved_by(c), directions[..., :count] @ c)
    c = torch.randn(5, generator=generator)
    G.directions = 2 * directions
    torch.testing.assert_close(G.moved_by(c), 2 * directions @ c)
    with torch.no_grad():
        G.directions.mul_(0.5)  # in place, as a state that is loaded
    torch.testing.assert_close(G.moved_by(c), directions @ c)
    with torch.inference_mode():
        G.directions = 3 * directions
        torch.testing.assert_close(G.moved_by(c), 3 * directions @ c)
        G.directions.mul_(2)
        torch.testing.assert_close(G.moved_by(c), 6 * directions @ c)
