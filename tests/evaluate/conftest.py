"""Videos that the tests of evaluation share, beside the tiny subject of :mod:`tests.conftest`."""

import json
from dataclasses import replace

import pytest
import torch

from gva_mi.body.pose import JOINTS, save_poses
from gva_mi.fit.renders import render_frame
from gva_mi.refine.refine import Refined
from gva_mi.subject.cameras import save_cameras
from gva_mi.subject.ground_truth import GroundTruth
from gva_mi.subject.pictures import write_image
from gva_mi.subject.video import load_video


@pytest.fixture(scope="session", autouse=True)
def quiet(one_thread):
    """Use one thread of torch: the tests may share the cores with others."""


@pytest.fixture(scope="session")
def studio(tmp_path_factory, known, camera, turning):
    """The known avatar on white, with masks of the whole picture, so cutting out changes no bit."""
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


@pytest.fixture(scope="session")
def estimated(video):
    """The tiny subject under stage-1 poses whose shoulders are off."""
    rotations = video.pose.rotations.clone()
    for name in ("left_shoulder", "right_shoulder"):
        rotations[:, JOINTS.index(name), 2] += 0.25
    return replace(video, pose=replace(video.pose, rotations=rotations))


@pytest.fixture(scope="session")
def truth(video, body):
    """The ground truth of the tiny subject."""
    return GroundTruth(body, video.pose, video.shape, video.cameras)


@pytest.fixture(scope="session")
def refined(video, estimated, body):
    """A refinement that found the true poses, except in the last frame, which keeps stage 1."""
    rotations = video.pose.rotations.clone()
    rotations[-1] = estimated.pose.rotations[-1]
    losses, offsets = torch.rand(6), torch.zeros_like(body.v_template)
    kept = {5: "its loss grew from 0.100 to <0.200>"}
    pose = replace(video.pose, rotations=rotations)
    return Refined(pose, video.shape, offsets, losses_stage1=losses + 0.1, losses=losses, kept=kept,
        without_normals=[1], seconds_per_frame=0.5)  # fmt: skip
