"""A small subject without a fault: the built-in body, turning beside the middle.

Its pictures are its silhouettes; masks and normals are the body's own. Tests break copies of it.
"""

import json
import shutil

import numpy as np
import pytest
import torch

from gva_mi.body.pose import Pose, Shape, save_poses
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.splat import Camera, look_at
from gva_mi.subject.cameras import save_cameras
from gva_mi.subject.pictures import write_image

WIDTH, HEIGHT, FRAMES = 80, 72, 8


@pytest.fixture(scope="session", autouse=True)
def quiet(one_thread):
    """All tests of this folder are of small tensors."""


def motion():
    """A turn of a quarter in steps to the side, one arm up: no frame like another or mirrored."""
    pose, time = Pose.rest(FRAMES), torch.linspace(0, 1, FRAMES)
    pose.rotations[:, 0, 1] = 0.3 + 1.5 * time
    pose.rotations[:, 16, 2] = -1.2 + 2.0 * time
    pose.rotations[:, 17, 2] = 1.2
    pose.rotations[:, 1, 0] = -0.6 * torch.sin(6 * time)
    pose.transl[:, 0] = 0.5 - 0.8 * time
    return pose


@pytest.fixture(scope="session")
def whole(tmp_path_factory, built_in_body):
    folder = tmp_path_factory.mktemp("whole") / "subject"
    pose, shape = motion(), Shape(torch.zeros(10))
    T = look_at((0.9, 0.4, 3.6), (0, -0.1, 0))
    camera = Camera(70.0, 70.0, WIDTH / 2, HEIGHT / 2, T, WIDTH, HEIGHT)
    scene = MeshScene(built_in_body.faces, built_in_body.v_template)
    (folder / "normals").mkdir(parents=True)
    for k in range(FRAMES):
        with torch.no_grad():
            vertices = built_in_body(pose[k], shape).vertices[0]
            seen = scene.render(vertices, camera).numpy()
        image = np.repeat(np.where(seen[..., 3:] > 0.5, 0.4, 0.9), 3, axis=-1)
        write_image(folder / f"frames/{k:06d}.png", image)
        write_image(folder / f"masks/{k:06d}.png", seen[..., 3])
        np.save(folder / f"normals/{k:06d}.npy", seen[..., :3])
    save_poses(folder / "poses.npz", pose, shape, stage=1)
    save_cameras(folder / "cameras.npz", [camera] * FRAMES)
    splits = {"train": [0, 1, 2, 4, 5, 6, 7], "test": [3]}
    (folder / "splits.json").write_text(json.dumps(splits))
    return folder


@pytest.fixture
def subject(whole, tmp_path):
    """A copy to break."""
    return shutil.copytree(whole, tmp_path / "subject")
