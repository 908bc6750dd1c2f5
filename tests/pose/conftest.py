"""A clip in memory: the bare puppet in known poses, seen as masks and normals of few pixels."""

from dataclasses import dataclass, field

import numpy as np
import pytest
import torch

from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.body.smplx import load_body
from gva_mi.data.video import Frame
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.splat import Camera, look_at

SIZE = 96


@dataclass
class Clip:
    """What ``refine`` needs of a Video."""

    pose: Pose
    shape: Shape
    pictures: list  # (mask, normals or None) of each frame
    camera: Camera
    absent: dict = field(default_factory=dict)

    def true_mask(self, index):
        return self.pictures[index][0]

    def __len__(self):
        return len(self.pictures)

    def frames(self, indices=None):
        for k in range(len(self)) if indices is None else indices:
            mask, normals = self.pictures[k]
            image = np.zeros((*mask.shape, 3), np.float32)
            yield Frame(k, image, mask, normals, self.camera, self.pose[k])


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


@pytest.fixture(scope="session")
def clip(body, scene, camera, true_pose):
    """Stage 1 is off at shoulders and elbows, by an error that changes slowly."""
    shape, pictures = Shape(torch.zeros(10)), []
    for k in range(len(true_pose)):
        with torch.no_grad():
            vertices = body(true_pose[k], shape).vertices[0]
            image = scene.render(vertices, camera).numpy()
        pictures.append((image[..., 3].copy(), image[..., :3].copy()))
    rotations = true_pose.rotations.clone()
    for name, angle in (("left_shoulder", 0.25), ("right_shoulder", 0.2), ("left_elbow", -0.2)):
        rotations[:, JOINTS.index(name), 2] += angle
    stage1 = Pose(rotations, true_pose.transl.clone(), true_pose.expression)
    return Clip(stage1, shape, pictures, camera)
