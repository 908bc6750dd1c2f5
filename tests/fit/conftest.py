"""A tiny subject made by a known avatar: the puppet in colours, turning before a camera."""

import json

import pytest
import torch

from gva_mi.avatar.avatar import AvatarOptions, seed_avatar
from gva_mi.avatar.canonical import SeedOptions
from gva_mi.body.pose import Pose, Shape, save_poses
from gva_mi.body.smplx import load_body
from gva_mi.data.pictures import write_image
from gva_mi.data.video import load_video, save_cameras
from gva_mi.fit.evaluate import render_frame, to_8bit
from gva_mi.splat import Camera, look_at
from gva_mi.splat.torch_op import render

SIZE, FRAMES = 48, 6
SEED = SeedOptions(count=600, sh_degree=1)
SHAPE = Shape(torch.zeros(10))
GREY = torch.full((3,), 0.3)


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
def known(body):
    """The avatar that the pictures show."""
    x = body.v_template
    stripes = 0.5 + 0.4 * torch.sin(torch.stack([9 * x[:, 0], 11 * x[:, 1], 7 * x.sum(1)], dim=1))
    generator = torch.Generator().manual_seed(5)
    return seed_avatar(body, SHAPE, None, AvatarOptions(seed=SEED), generator, stripes)


@pytest.fixture(scope="session")
def camera(body):
    low, high = body.v_template.amin(0), body.v_template.amax(0)
    centre = ((low + high) / 2).numpy()
    focal = 0.9 * SIZE * 3 / float((high - low).max())
    return Camera(focal, focal, SIZE / 2, SIZE / 2, look_at(centre + (0, 0, 3), centre), SIZE, SIZE)


def turning(frames, start=0.0):
    """Once around, with the arms moving."""
    rotations = torch.zeros(frames, 55, 3)
    turn = torch.arange(frames) / frames
    rotations[:, 0, 1] = start + 2 * torch.pi * turn
    rotations[:, 16, 2] = -0.6 + 0.3 * torch.sin(7 * turn)
    rotations[:, 17, 2] = 0.6 + 0.3 * torch.sin(5 * turn)
    return Pose(rotations, torch.zeros(frames, 3), torch.zeros(frames, 10))


@pytest.fixture(scope="session")
def subject(tmp_path_factory, known, camera):
    """Before a grey wall, with the avatar's alpha as masks; frame 3 is the test frame."""
    folder, pose = tmp_path_factory.mktemp("subject"), turning(FRAMES)
    for k in range(FRAMES):
        with torch.no_grad():
            image = render(known(pose[k]), camera, background=GREY)
        write_image(folder / f"frames/{k:06d}.png", to_8bit(image.color.numpy()))
        write_image(folder / f"masks/{k:06d}.png", to_8bit(image.alpha.numpy()))
    save_poses(folder / "poses.npz", pose, SHAPE, stage=1)
    save_cameras(folder / "cameras.npz", [camera] * FRAMES)
    (folder / "splits.json").write_text(json.dumps({"train": [0, 1, 2, 4, 5], "test": [3]}))
    return folder


@pytest.fixture(scope="session")
def video(subject):
    return load_video(subject)


@pytest.fixture(scope="session")
def studio(tmp_path_factory, known, camera):
    """The same on white with masks that leave nothing out, so that cutting out changes no bit."""
    folder = tmp_path_factory.mktemp("studio")
    for part, pose in ((folder, turning(2)), (folder / "truth/novel_pose", turning(2, start=0.5))):
        for k in range(2):
            picture = render_frame(known, pose[k], camera)
            write_image(part / f"frames/{k:06d}.png", picture)
            write_image(part / f"masks/{k:06d}.png", torch.ones(SIZE, SIZE).numpy())
        save_poses(part / "poses.npz", pose, SHAPE, stage=1)
        save_cameras(part / "cameras.npz", [camera] * 2)
    (folder / "splits.json").write_text(json.dumps({"train": [0], "test": [1]}))
    return load_video(folder)
