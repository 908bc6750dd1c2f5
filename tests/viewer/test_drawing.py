"""Pictures have the bits of ``render``, and every way to show the avatar follows its pose."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest
import torch

from gva_mi.body.pose import JOINTS
from gva_mi.fit.renders import over, render_layer
from gva_mi.mesh.overlay import OUTLINE
from gva_mi.mesh.surface import vertex_normals
from gva_mi.mesh.visibility import seen_vertices
from gva_mi.viewer.state import Mode, State
from gva_mi.viewer.surface import SurfaceRenderer, draw_skeleton, posed_surface

SHOULDER = JOINTS.index("left_shoulder")


@pytest.fixture(scope="module")
def surfaces(known):
    return SurfaceRenderer(known.rig)


def test_each_frame_has_the_bits_of_render(known, motion, drawing, camera):
    for k in (2, 0, 3, 3):
        found = drawing.picture(State(frame=k), camera)
        assert np.array_equal(found, over(render_layer(known, motion[k], camera), np.ones(3, "f4")))


def test_a_turned_joint_changes_every_kind_of_picture(drawing, camera):
    for mode in get_args(Mode):
        rest = State(mode=mode)
        turned = replace(rest, turned=((SHOULDER, (0.0, 0.0, 40.0)),))
        first, other, again = (drawing.picture(x, camera) for x in (rest, turned, rest))
        assert (first < 250).any() and np.array_equal(first, again), mode
        assert (np.abs(first.astype(int) - other) > 20).sum() > 20, mode


def test_the_surface_is_the_posed_body(body, known, motion, turning):
    pose = motion[2]
    pose.expression[0, :4] = torch.tensor([1.0, -1, 0.5, 2])
    pose.rotations[0, SHOULDER] = torch.tensor([0.3, -0.8, 0.2])
    truth = body(pose, turning(1)[1])
    found = posed_surface(known, pose)
    assert torch.allclose(found.vertices, truth.vertices[0], atol=2e-5)
    assert np.allclose(found.joints, truth.joints[0].numpy(), atol=2e-5)


def test_normals_are_drawn_with_y_up_and_z_toward_the_viewer(known, motion, surfaces, camera):
    camera = camera.resized(192, 192)
    surface = posed_surface(known, motion[0])
    faces = known.rig.faces
    layer = surfaces.layer("normals", surface, camera, fine=True)
    seen = seen_vertices(surface.vertices, faces, camera.position[None])[0].numpy()
    truth = vertex_normals(surface.vertices, faces).numpy() @ camera.T_camera_world[:3, :3].T
    columns, rows = camera.project(surface.vertices.double().numpy()).astype(int).T
    seen &= layer[rows, columns, 3] == 1
    error = np.abs(2 * layer[rows, columns, :3] - 1 - truth * (1, -1, -1))[seen]
    assert seen.sum() > 1000 and np.median(error) < 0.05 and error.mean() < 0.12


def test_joints_are_projected_and_the_marked_one_is_orange(known, motion, camera):
    camera = camera.resized(192, 192)
    joints = posed_surface(known, motion[0]).joints
    layer = draw_skeleton(joints, known.rig.parents, camera, SHOULDER)
    column, row = camera.project(joints[SHOULDER]).astype(int)
    assert np.allclose(layer[row, column], (*OUTLINE, 1), atol=0.02)
    for x, y in camera.project(joints).astype(int):
        assert layer[y, x, 3] > 0.5
    assert draw_skeleton(-joints - 100, known.rig.parents, camera, 0).shape == layer.shape
