"""The bare puppet before a camera, few pixels, in three poses."""

import pytest
import torch

from gva_mi.body.pose import JOINTS, Pose
from gva_mi.body.smplx import load_body
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.splat import Camera, look_at

SIZE = 96


@pytest.fixture(scope="session", autouse=True)
def one_thread():
    """Tests may share the cores with others: OpenMP's threads would wait for each other."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="session")
def body():
    return load_body()


@pytest.fixture(scope="session")
def scene(body):
    return MeshScene(body.faces, body.v_template)


@pytest.fixture(scope="session")
def camera(body):
    low, high = body.v_template.amin(0), body.v_template.amax(0)
    centre = ((low + high) / 2).numpy()
    focal = 0.8 * SIZE * 3 / float((high - low).max())
    T_camera_world = look_at(centre + (0.2, 0.1, 3), centre)
    return Camera(focal, focal, SIZE / 2, SIZE / 2, T_camera_world, SIZE, SIZE)


@pytest.fixture(scope="session")
def true_pose():
    """Three frames in which the arms sink and the trunk turns."""
    rotations = torch.zeros(3, 55, 3)
    time = torch.tensor([0.0, 1.0, 2.0])
    rotations[:, 0, 1] = 0.15 * time
    rotations[:, JOINTS.index("left_shoulder"), 2] = -0.5 - 0.1 * time
    rotations[:, JOINTS.index("right_shoulder"), 2] = 0.5 + 0.1 * time
    return Pose(rotations, torch.zeros(3, 3), torch.zeros(3, 10))
