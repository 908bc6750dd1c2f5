"""The built-in body: a closed symmetric surface whose coefficients mean what they say."""

from copy import deepcopy

import numpy as np
import pytest
import torch
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from gva_mi.body.pose import JOINTS, Pose, Shape, mirrored_name
from gva_mi.body.smplx import load_body

F64 = torch.float64
MIRRORED = [JOINTS.index(mirrored_name(name)) for name in JOINTS]


@pytest.fixture(scope="module")
def body():
    return load_body(dtype=F64)


def pose_with(**rotations):
    """Return a pose of one frame from rotations (3,) by joint."""
    pose = Pose.rest(dtype=F64)
    for name, rotation in rotations.items():
        pose.rotations[0, JOINTS.index(name)] = torch.tensor(rotation, dtype=F64)
    return pose


def volume(vertices, faces):
    a, b, c = vertices[faces].unbind(1)
    return (torch.linalg.cross(a, b) * c).sum().item() / 6


def neutral():
    return Shape(torch.zeros(10, dtype=F64))


def test_the_surface_is_closed_connected_and_without_handles(body):
    faces, n = body.faces.numpy(), len(body.v_template)
    edges = np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])
    codes = edges[:, 0] * n + edges[:, 1]
    back = edges[:, 1] * n + edges[:, 0]
    assert len(np.unique(codes)) == len(codes)
    np.testing.assert_array_equal(np.sort(codes), np.sort(back))  # each edge once either way
    graph = coo_matrix((np.ones(len(edges)), edges.T), (n, n))
    assert connected_components(graph)[0] == 1
    assert n - len(edges) // 2 + len(faces) == 2  # Euler
    assert 0.05 < volume(body.v_template, body.faces) < 0.09  # cubic metres, faces point outward


def test_left_and_right_are_mirror_images(body):
    vertices, weights = body.v_template.numpy(), body.weights.numpy()
    distance, mirror = cKDTree(vertices).query(vertices * (-1, 1, 1))
    assert distance.max() == 0
    np.testing.assert_allclose(weights[mirror][:, MIRRORED], weights, atol=1 / 4096)
    assert ((weights > 0).sum(1) <= 4).all() and (weights.sum(1) == 1).all()
    joints = body.rest(neutral()).joints.numpy()
    np.testing.assert_allclose(joints[MIRRORED] * (-1, 1, 1), joints, atol=1e-6)


@pytest.mark.parametrize(
    "joint, rotation", [("left_elbow", (0, -2.0, 0)), ("right_knee", (2.0, 0, 0))]
)
def test_correctives_keep_volume_where_a_joint_bends(body, joint, rotation):
    pose = pose_with(**{joint: rotation})
    corrected = volume(body(pose, neutral()).vertices[0], body.faces)
    plain = deepcopy(body)
    plain.frame_directions[: len(plain.pose_features)].zero_()
    collapsed = volume(plain(pose, neutral()).vertices[0], body.faces)
    rest = volume(body.v_template, body.faces)
    assert collapsed < rest
    assert abs(corrected - rest) < 0.6 * (rest - collapsed)
