"""What the tests of a fit share beside the tiny subject of :mod:`tests.conftest`."""

import json

import pytest
import torch

from gva_mi.body.pose import save_poses
from gva_mi.data.pictures import write_image
from gva_mi.data.video import load_video, save_cameras
from gva_mi.fit.renders import render_frame


@pytest.fixture(scope="session", autouse=True)
def quiet(one_thread):
    """All tests of this folder are of tensors."""


@pytest.fixture(scope="session")
def studio(tmp_path_factory, known, camera, turning):
    """The same on white with masks that leave nothing out, so that cutting out changes no bit."""
    folder = tmp_path_factory.mktemp("studio")
    size = (camera.height, camera.width)
    for part, (pose, shape) in (
        (folder, turning(2)),
        (folder / "truth/novel_pose", turning(2, start=0.5)),
    ):
        for k in range(2):
            picture = render_frame(known, pose[k], camera)
            write_image(part / f"frames/{k:06d}.png", picture)
            write_image(part / f"masks/{k:06d}.png", torch.ones(size).numpy())
        save_poses(part / "poses.npz", pose, shape, stage=1)
        save_cameras(part / "cameras.npz", [camera] * 2)
    (folder / "splits.json").write_text(json.dumps({"train": [0], "test": [1]}))
    return load_video(folder)
