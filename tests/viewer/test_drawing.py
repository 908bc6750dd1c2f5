"""Pictures: Gaussians to the bit as ``render`` draws them, and every control changes some."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gva_mi.body.pose import JOINTS
from gva_mi.data.pictures import read_background
from gva_mi.fit.renders import over, render_layer
from gva_mi.mesh.overlay import OUTLINE
from gva_mi.mesh.surface import vertex_normals
from gva_mi.mesh.visibility import seen_vertices
from gva_mi.viewer.drawing import Drawing, flattened
from gva_mi.viewer.skeleton import draw_skeleton
from gva_mi.viewer.state import State
from gva_mi.viewer.surface import SurfaceDrawing, posed_surface

SHOULDER = JOINTS.index("left_shoulder")
MODES = ("Gaussians", "mesh", "normals", "skeleton")


@pytest.fixture(scope="module")
def surfaces(known):
    return SurfaceDrawing(known.rig)


def test_each_frame_is_that_of_render_to_the_bit(known, motion, drawing, camera):
    for k in (2, 0, 3, 3):
        found = drawing.picture(State(frame=k), camera)
        assert np.array_equal(found, over(render_layer(known, motion[k], camera), np.ones(3, "f4")))


def test_before_a_colour_as_render_has_it(known, motion, drawing, camera):
    behind = read_background("#336699", camera.width, camera.height)
    expected = over(render_layer(known, motion[0], camera), behind)
    found = drawing.picture(State(background=(0x33, 0x66, 0x99)), camera)
    assert np.array_equal(found, expected)


@pytest.mark.parametrize("mode", MODES)
def test_a_joint_changes_the_picture_and_back(drawing, camera, mode):
    rest = State(mode=mode)
    turned = replace(rest, turned=((SHOULDER, (0.0, 0.0, 40.0)),))
    first, other, again = (drawing.picture(x, camera) for x in (rest, turned, rest))
    assert (first < 250).any() and np.array_equal(first, again)
    assert (np.abs(first.astype(int) - other) > 20).sum() > 20


@pytest.mark.parametrize("mode", MODES)
def test_what_is_outside_the_picture_is_not_drawn(drawing, camera, mode):
    aside = camera.cropped(10_000, 0, 48, 48)
    assert not drawing.layer(State(mode=mode), aside).any()


def test_an_expression_opens_the_mouth(known, motion, drawing, camera):
    near = camera.zoomed(5).cropped(0, -100, 48, 48)  # the head
    layers = [drawing.layer(State(expression=e), near) for e in ((), (3.0, *[0.0] * 9))]
    assert np.abs(layers[0] - layers[1]).max() > 0.1


def test_the_surface_is_the_body_as_it_is_posed(body, known, motion, turning):
    pose = motion[2]
    pose.expression[0, :4] = torch.tensor([1.0, -1, 0.5, 2])
    pose.rotations[0, SHOULDER] = torch.tensor([0.3, -0.8, 0.2])
    truth = body(pose, turning(1)[1])
    found = posed_surface(known, known.rig, pose)
    assert torch.allclose(found.vertices, truth.vertices[0], atol=2e-5)
    assert np.allclose(found.joints, truth.joints[0].numpy(), atol=2e-5)


def test_normals_are_the_surface_s_own_in_the_camera_s_axes(known, motion, surfaces, camera):
    camera = camera.resized(192, 192)
    surface = posed_surface(known, known.rig, motion[0])
    faces = known.rig.faces
    layer = surfaces.normals(surface, camera, fine=True)
    seen = seen_vertices(surface.vertices, faces, camera.position[None])[0].numpy()
    truth = vertex_normals(surface.vertices, faces).numpy() @ camera.T_camera_world[:3, :3].T
    columns, rows = camera.project(surface.vertices.double().numpy()).astype(int).T
    seen &= layer[rows, columns, 3] == 1
    error = np.abs(2 * layer[rows, columns, :3] - 1 - truth)[seen]
    assert seen.sum() > 1000 and np.median(error) < 0.05 and error.mean() < 0.12


def test_few_triangles_draw_nearly_the_same(known, motion, surfaces, camera):
    camera = camera.resized(192, 192)
    surface = posed_surface(known, known.rig, motion[1])
    fine, coarse = (surfaces.shaded(surface, camera, x) for x in (True, False))
    assert 0.9 < fine[..., 3].sum() / coarse[..., 3].sum() < 1.1
    both = (fine[..., 3] == 1) & (coarse[..., 3] == 1)
    assert np.abs(fine - coarse)[both].mean() < 0.03


def test_the_whole_picture_is_drawn_where_a_part_lies_behind(known, motion, surfaces, camera):
    """A camera within the body sees it from inside, and nothing is divided by zero."""
    T = camera.T_camera_world.copy()
    T[2, 3] = 0.0
    inside = replace(camera, T_camera_world=T)
    surface = posed_surface(known, known.rig, motion[0])
    assert np.isfinite(surfaces.shaded(surface, inside, False)).all()


def test_joints_lie_where_the_camera_sees_them_and_the_marked_one_is_orange(known, motion, camera):
    camera = camera.resized(192, 192)
    joints = posed_surface(known, known.rig, motion[0]).joints
    layer = draw_skeleton(joints, known.rig.parents, camera, SHOULDER)
    column, row = camera.project(joints[SHOULDER]).astype(int)
    assert np.allclose(layer[row, column], (*OUTLINE, 1), atol=0.02)
    for x, y in camera.project(joints).astype(int):
        assert layer[y, x, 3] > 0.5
    assert draw_skeleton(-joints - 100, known.rig.parents, camera, 0).shape == layer.shape


def test_a_frame_of_the_video_stands_in_the_middle(known, video):
    drawing = Drawing(known, video.pose, video)
    found = drawing.frame(State(frame=4, background=(9, 9, 9)), 200, 48)
    image = np.round(255 * video[4].image).astype(np.uint8)
    assert np.array_equal(found[:, 76:124], image)
    assert (found[:, :76] == 9).all() and (found[:, 124:] == 9).all()


def test_a_layer_is_flattened_as_a_whole_one_would_be():
    layer = np.zeros((20, 30, 4), np.float32)
    assert (flattened(layer, (1, 2, 3)) == (1, 2, 3)).all()
    layer[3:9, 20:] = np.random.default_rng(0).random((6, 10, 4)).astype(np.float32)
    colour = np.array((1, 2, 3), np.float32) / 255
    assert np.array_equal(flattened(layer, (1, 2, 3)), over(layer, colour))
