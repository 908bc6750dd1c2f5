"""A clip in memory: the bare built-in body in known poses, as small masks and normals."""

from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.mesh.surface import CoarseBody
from gva_mi.splat import Camera
from gva_mi.subject.landmarks import Landmarks
from gva_mi.subject.video import Frame, FrameWithoutPicture


@dataclass
class Clip:
    """The parts of a ``Video`` that ``refine`` uses."""

    pose: Pose
    shape: Shape
    pictures: list  # (mask, normals or None) of each frame
    camera: Camera
    absent: dict = field(default_factory=dict)
    folder: Path = Path()  # of a disk cache
    landmarks: Landmarks | None = None
    kind: str | None = None
    fps: float | None = None
    splits: SimpleNamespace = field(default_factory=lambda: SimpleNamespace(test=[]))

    def true_mask(self, index):
        return self.pictures[index][0]

    def __len__(self):
        return len(self.pictures)

    @property
    def cameras(self):
        return [self.camera] * len(self)

    def frames(self, indices=None):
        for k in range(len(self)) if indices is None else indices:
            mask, normals = self.pictures[k]
            image = np.zeros((*mask.shape, 3), np.float32)
            yield Frame(k, image, mask, normals, self.camera, self.pose[k])

    def outlines(self, indices):
        for frame in self.frames(indices):
            yield _outline_of(frame)


def _outline_of(frame):
    normals = lambda part: None if frame.normals is None else frame.normals[part]
    return FrameWithoutPicture(frame.index, frame.mask, normals, frame.camera, frame.pose)


@pytest.fixture(scope="session")
def outline_of():
    """Converts a frame to an outline, as a Video reads it."""
    return _outline_of


@pytest.fixture(scope="session", autouse=True)
def quiet(one_thread):
    """Limit torch to one thread."""


@pytest.fixture(scope="session")
def coarse(body):
    """The body on few triangles, which no refinement has to simplify again."""
    return CoarseBody(body, 2000).body


@pytest.fixture(scope="session")
def scene(body_scene):
    return body_scene


@pytest.fixture(scope="session")
def camera(body_camera):
    return body_camera


@pytest.fixture(scope="session")
def seen_in(body, scene, camera):
    """``seen_in(poses)``: mask and normals of the bare body in each of some poses."""

    @torch.no_grad()
    def pictures(poses):
        vertices = body(poses, Shape(torch.zeros(10))).vertices
        images = [scene.render(x, camera).numpy() for x in vertices]
        return [(image[..., 3].copy(), image[..., :3].copy()) for image in images]

    return pictures


@pytest.fixture(scope="session")
def clip(seen_in, camera, true_pose):
    """Stage 1 has constant errors at shoulders and an elbow."""
    shape, pictures = Shape(torch.zeros(10)), seen_in(true_pose)
    rotations = true_pose.rotations.clone()
    for name, angle in (("left_shoulder", 0.25), ("right_shoulder", 0.2), ("left_elbow", -0.2)):
        rotations[:, JOINTS.index(name), 2] += angle
    stage1 = Pose(rotations, true_pose.transl.clone(), true_pose.expression)
    return Clip(stage1, shape, pictures, camera)
