"""Ground truth is on the body that was filmed."""

from unittest.mock import MagicMock

import numpy as np
import pytest
import torch

from gva_mi import InputError
from gva_mi.body.body_file import BUILT_IN_BODY
from gva_mi.body.pose import Pose, Shape, save_poses
from gva_mi.body.smplx import load_body
from gva_mi.splat import Camera
from gva_mi.subject.cameras import save_cameras
from gva_mi.subject.ground_truth import load_ground_truth, truth_of


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "truth").mkdir()
    save_poses(tmp_path / "truth/poses.npz", Pose.rest(2), Shape(torch.ones(10)), stage=0)
    save_cameras(tmp_path / "cameras.npz", [camera(60.0)])
    return tmp_path / "truth"


def camera(focal):
    return Camera(focal, focal, 32, 32, np.eye(4), 64, 64)


def test_without_a_body_file_the_fitted_body_was_filmed(folder):
    body = load_body()
    truth = load_ground_truth(folder, body)
    assert truth.body is body and not truth.foreign
    assert len(truth.pose) == 2 and torch.equal(truth.shape.betas, torch.ones(10))


def test_a_body_file_is_the_body_that_was_filmed(folder):
    with np.load(BUILT_IN_BODY) as arrays:
        larger = {**arrays, "v_template": 1.1 * arrays["v_template"]}
    np.savez(folder / "body.npz", **larger)
    body = load_body()
    truth = load_ground_truth(folder, body)
    assert truth.foreign and torch.allclose(truth.body.v_template, 1.1 * body.v_template)


def test_without_cameras_of_its_own_the_video_s_are_ground_truth(folder):
    assert [c.fx for c in load_ground_truth(folder, load_body()).cameras] == [60.0, 60.0]
    save_cameras(folder / "cameras.npz", [camera(54.0)])
    assert [c.fx for c in load_ground_truth(folder, load_body()).cameras] == [54.0, 54.0]


def test_ground_truth_of_another_length_is_named(folder):
    body, video = load_body(), MagicMock(truth=folder)
    video.__len__.return_value = 3
    with pytest.raises(InputError, match=r"poses.npz: holds 2 frames, but the video has 3"):
        truth_of(video, body)
    (folder / "poses.npz").unlink()
    assert truth_of(video, body) is None
