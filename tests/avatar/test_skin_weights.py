"""Weights of the outer skin: the body's on bare skin, diffused on loose cloth, never torn."""

from dataclasses import replace

import numpy as np
import torch
from scipy.spatial import cKDTree

from gva_mi.avatar.rig import Skin, SkinningOptions, diffused
from gva_mi.body.pose import JOINTS

LEFT, RIGHT = JOINTS.index("left_hip"), JOINTS.index("right_hip")


def of_nearest(points, skin):
    """Weights of the nearest vertex, which jump."""
    _, nearest = cKDTree(skin.vertices.double().numpy()).query(points.double().numpy())
    return skin.weights[nearest]


def still(vertices, weights):
    """A skin without blend shapes."""
    count = len(vertices)
    return Skin(vertices, weights, torch.arange(count), vertices.new_zeros(count, 3, 0))


def sheet(width=0.4, height=0.3, cells=20):
    """A square-celled sheet in the plane z = 0, and its triangles."""
    x, y = np.meshgrid(np.linspace(-width / 2, width / 2, cells), np.linspace(0, height, cells))
    vertices = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    i = np.arange(cells * (cells - 1)).reshape(-1, cells)[:, :-1].ravel()
    faces = [[i, i + 1, i + cells], [i + 1, i + cells + 1, i + cells]]
    return vertices, np.concatenate([np.stack(f, axis=1) for f in faces])


def legs(height=0.3, apart=0.4):
    """Two vertical lines of vertices that follow one hip each."""
    y = np.linspace(0, height, 40)
    lines = [np.stack([0 * y + side * apart / 2, y, 0 * y], axis=1) for side in (1, -1)]
    weights = torch.zeros(80, 55)
    weights[:40, LEFT] = weights[40:, RIGHT] = 1
    return still(torch.from_numpy(np.concatenate(lines)).float(), weights)


def test_as_printed_a_point_has_the_four_joints_of_the_nearest_vertex(body):
    """Eq. 5, P = 4; also on cloth."""
    options = SkinningOptions(spread=0.0, neighbours=1, joints=4)
    own = replace(still(body.v_template, body.weights), options=options)
    vertices, faces = sheet()
    assert diffused(vertices, faces, own, torch.full((642,), 0.1)) is own
    points = 1.1 * body.v_template[::7] + 0.003
    found, near = own.bind(points)["weights"], of_nearest(points, own)
    four = near.topk(4, dim=1)
    expected = torch.zeros_like(near).scatter(1, four.indices, four.values)
    torch.testing.assert_close(found, expected / expected.sum(1, keepdim=True))


def test_weights_on_a_sheet_between_two_legs_are_blended():
    vertices, faces = sheet()
    both = legs()
    skin = diffused(vertices, faces, both, torch.zeros(80))
    share = skin.weights[:, LEFT].double().numpy().reshape(20, 20)
    assert np.allclose(share[:, [0, -1]], [0, 1], atol=0.02)  # it touches them
    assert (np.diff(share, axis=1) > -1e-6).all()  # and rises from one to the other
    jump = np.diff(share, axis=1).max()
    nearest = of_nearest(skin.vertices, both)[:, LEFT]
    assert jump < 0.15 and np.diff(nearest.view(20, 20).numpy(), axis=1).max() == 1
    assert np.allclose(share, 1 - share[:, ::-1], atol=1e-2)  # left and right are alike


def test_blend_shapes_are_those_of_the_vertex_beneath(body):
    """A hat on a ball: it takes the blend shapes of the vertices beneath."""
    directions = torch.zeros(642, 3, 2)
    face = body.v_template[:, 2] > 0.1
    directions[face, 1, 0], directions[face, 2, 1] = 0.01, -0.02
    own = Skin(body.v_template, body.weights, torch.arange(642), directions)
    out = diffused(
        1.01 * body.v_template.double().numpy(), body.faces.numpy(), own, torch.zeros(642)
    )
    found = out.bind(1.01 * body.v_template)["directions"]
    torch.testing.assert_close(found, directions)


def test_slopes_of_linear_weights_on_a_sheet_are_exact_along_it_and_zero_across():
    vertices = torch.from_numpy(sheet()[0]).float()
    weights, wanted = torch.zeros(len(vertices), 55), torch.zeros(3, 55)
    wanted[:, LEFT] = torch.tensor([1.5, -0.5, 0])
    wanted[:, RIGHT] = -wanted[:, LEFT]
    weights[:, LEFT] = 0.5 + vertices @ wanted[:, LEFT]
    weights[:, RIGHT] = 1 - weights[:, LEFT]
    slopes = still(vertices, weights).bind(vertices)["slopes"]
    # What keeps eq. 3 from making anything up across shortens it a little along, too.
    torch.testing.assert_close(slopes, wanted.expand_as(slopes), rtol=0.05, atol=0.02)
    assert (slopes[:, 2] == 0).all()
    torch.testing.assert_close(slopes.sum(2), torch.zeros(len(vertices), 3), atol=1e-6, rtol=0)
