"""The error model "video": networks and solver see a rendered subject, in the true world."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from gva_mi.body.pose import Pose, Shape
from gva_mi.evaluate.pose_errors import means, pose_errors
from gva_mi.splat.camera import Camera, look_at
from gva_mi.study.videos import nudged, steadied, watch_take
from gva_mi.subject.ground_truth import GroundTruth, load_ground_truth
from gva_mi.subject.splits import Splits
from gva_mi.subject.video import load_video
from gva_mi.synthetic import SynthOptions, make_subject


def test_a_steadied_pose_is_seen_by_the_first_camera_as_each_frame_s_camera_saw_it(built_in_body):
    shape, pose = Shape(torch.tensor([0.5])), Pose.rest(2)
    pose.rotations[1, 0] = torch.tensor([0.1, 0.4, 0.0])
    eyes = (0.0, 1.6, 3.0), (0.1, 1.5, 3.1)
    views = [look_at(eye, (0.0, 0.9, 0.0)) for eye in eyes]
    cameras = [Camera(500.0, 500.0, 128.0, 128.0, T, 256, 256) for T in views]
    still = steadied(GroundTruth(built_in_body, pose, shape, cameras))
    before, after = (built_in_body(some, shape).joints.double().numpy() for some in (pose, still))
    for k, camera in enumerate(cameras):
        seen = cameras[0].project(after[k])
        np.testing.assert_allclose(seen, camera.project(before[k]), atol=1e-2)


@dataclass(frozen=True)
class Posed:
    """What a video's poses and splits are."""

    pose: Pose
    splits: Splits


def test_a_nudge_is_one_ulp_of_one_number_of_a_training_frame():
    video = Posed(replace(Pose.rest(9), transl=torch.rand(9, 3)), Splits.of_video(9))
    assert nudged(video, 0) is video
    for run in (1, 2):
        before, after = (v.pose.transl.numpy() for v in (video, nudged(video, run)))
        ((frame, axis),) = np.argwhere(before != after)
        assert (frame, axis) == (video.splits.train[run - 1], 0)
        assert after[frame, axis] == np.nextafter(before[frame, axis], np.float32(np.inf))


@pytest.mark.slow
def test_a_watched_subject_stands_where_the_true_one_does(tmp_path, built_in_body):
    few = {"frames": 12, "samples": 4, "novel_poses": 0, "novel_views": 0}
    options = SynthOptions(seed=101, size=256, scene="room", **few)
    make_subject(tmp_path / "take", options, built_in_body)
    watch_take(tmp_path / "take", tmp_path / "filmed", built_in_body)
    video = load_video(tmp_path / "filmed")
    truth = load_ground_truth(video.truth, built_in_body)
    errors = means(pose_errors(built_in_body, (video.pose, video.shape), truth))
    assert video.kind == "video" and len(video) == len(video.landmarks) == 12
    assert video.fps == 12 / 6.0  # one round takes six seconds
    assert video.normals is None
    assert errors["body"] < 150 and abs(errors["pelvis_depth"]) < 120
    watch_take(tmp_path / "take", tmp_path / "any", built_in_body, lens=False)
    found, true = (load_video(tmp_path / name).cameras[0].fx for name in ("any", "filmed"))
    assert found != true and found == pytest.approx(true, rel=0.5)
    kept = load_ground_truth(tmp_path / "any/truth", built_in_body).cameras[0]
    assert kept.fx == pytest.approx(true)
