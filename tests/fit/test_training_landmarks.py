"""Landmarks hold poses while they are trained along with an avatar."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from gva_mi.avatar.rig import Rig
from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.fit.poses import PoseOptions, TrainedPoses
from gva_mi.fit.training_landmarks import TrainingLandmarks
from gva_mi.observe.face_points import NOSE_AND_EYES, FacePoints
from gva_mi.observe.rig import LandmarkRig
from gva_mi.splat import Camera, look_at
from gva_mi.subject.landmarks import BODY_LANDMARKS, FACE_LANDMARKS, Landmarks
from gva_mi.subject.splits import Splits

HEAD, SHOULDER, ELBOW = map(JOINTS.index, ("head", "left_shoulder", "left_elbow"))
FRAMES, TEST = 16, 5
CAMERA = Camera(900, 900, 270, 200, look_at((0, 0.5, 2.2), (0, 0.35, 0)), 540, 960)
OFFSET = torch.tensor([0.001, -0.006, 0.004])  # metres, of this person's face


@pytest.fixture(scope="module")
def true():
    """Somebody whose head turns from side to side."""
    pose = Pose.rest(FRAMES)
    pose.rotations[:, HEAD, 1] = 0.5 * torch.sin(torch.arange(FRAMES) / 2)
    return pose


@pytest.fixture(scope="module")
def video(true, built_in_body):
    shape = Shape(torch.linspace(-1, 1, 10))
    rig = LandmarkRig.of(built_in_body, BODY_LANDMARKS)
    face = FacePoints.of(built_in_body).at_rest(shape.betas.double()).float() + OFFSET
    x = torch.cat([rig.at_rest(shape.betas), face])
    joints = torch.cat([rig.joints, torch.full((len(face),), HEAD)])
    T = built_in_body(true, shape).T_world_rest[:, joints]
    places = ((T[..., :3, :3] @ x[..., None])[..., 0] + T[..., :3, 3]).double().numpy()
    metric = places @ CAMERA.T_camera_world[:3, :3].T
    places = np.stack([CAMERA.project(frame) for frame in places])
    seen = np.ones(places.shape[:2])
    names = (*BODY_LANDMARKS, *FACE_LANDMARKS)
    return SimpleNamespace(
        landmarks=Landmarks(names, places, seen, 0 * seen, metric),
        shape=shape, pose=true, cameras=[CAMERA] * FRAMES,
        splits=Splits(tuple(k for k in range(FRAMES) if k != TEST), (TEST,)),
    )  # fmt: skip


def test_the_offsets_of_a_person_s_face_come_back(video, built_in_body):
    seen = TrainingLandmarks.of(video, built_in_body)
    body, face = seen.offsets[: -len(NOSE_AND_EYES)], seen.offsets[-len(NOSE_AND_EYES) :]
    across, toward = (face - OFFSET).abs().split([2, 1], dim=1)
    assert across.max() < 0.001 and toward.max() < 0.002  # a frontal face hardly shows depth
    assert body.abs().max() < 1e-4
    assert seen.losses(video.pose, range(FRAMES)).max() < 0.2


@pytest.fixture(scope="module")
def wrong(video):
    """The same video with heads and an arm that are off by up to 9 degrees."""
    pose = Pose(video.pose.rotations.clone(), video.pose.transl, video.pose.expression)
    pose.rotations[:, HEAD, 1] += 0.15 * torch.cos(torch.arange(FRAMES) / 3)
    pose.rotations[:, SHOULDER, 2] += 0.15 * torch.sin(torch.arange(FRAMES) / 3)
    return SimpleNamespace(**vars(video) | {"pose": pose})


def test_the_head_that_fits_the_landmarks_is_the_true_one(video, wrong, built_in_body):
    seen = TrainingLandmarks.of(wrong, built_in_body)
    frames, rotations = seen.frames_among(range(FRAMES)), wrong.pose.rotations
    turns = torch.zeros(len(frames), 3, requires_grad=True)
    adam = torch.optim.Adam([turns], lr=0.01)

    def turned():
        head = rotations[frames].index_add(1, torch.tensor([HEAD]), turns[:, None])
        return Pose(head, wrong.pose.transl[frames], wrong.pose.expression[frames])

    for step in range(300):
        adam.zero_grad()
        seen.losses(turned(), frames).sum().backward()
        adam.step()
        if step % 10 == 0:
            seen.fit_offsets(wrong.pose.with_frames(frames, turned()))
    errors = lambda pose: (pose.rotations - video.pose.rotations[frames])[:, HEAD].detach()
    varying = lambda pose: errors(pose).std(0).norm()  # a constant one is an offset of the face
    before, after = varying(wrong.pose[frames]), varying(turned())
    assert after < 0.2 * before, (before, after)


def step(poses, done):
    """A step in which the picture tells nothing of the pose."""
    (0 * poses(done % FRAMES).transl).sum().backward()
    poses.step(done)


def test_training_follows_the_landmarks(video, wrong, built_in_body):
    rig = Rig.of(built_in_body, video.shape)

    def trained(seen):
        options, steps = PoseOptions(every=1), 100
        given = wrong.pose, wrong.cameras, rig, options, steps
        poses = TrainedPoses(*given, as_given=True, seen=seen)
        for done in range(1, steps + 1):
            step(poses, done)
        return poses.all()

    seen = TrainingLandmarks.of(video, built_in_body)
    frames = seen.frames_among(range(FRAMES))
    loss = lambda seen_: float(seen.losses(trained(seen_)[frames], frames).mean())
    assert loss(TrainingLandmarks.of(wrong, built_in_body)) < 0.5 * loss(None)
    elbow = lambda pose: built_in_body(pose, video.shape).joints[:, ELBOW]
    off = lambda pose: float((elbow(pose) - elbow(video.pose)).norm(dim=1).mean())
    assert off(trained(TrainingLandmarks.of(wrong, built_in_body))) < 0.7 * off(wrong.pose)


def test_each_clip_of_a_long_video_follows_its_own_landmarks(video, wrong, built_in_body):
    rig, steps = Rig.of(built_in_body, video.shape), 200
    options, seen = (
        PoseOptions(every=1, part=FRAMES // 2),
        TrainingLandmarks.of(wrong, built_in_body),
    )
    poses = TrainedPoses(wrong.pose, wrong.cameras, rig, options, steps, as_given=True, seen=seen)
    for done in range(1, steps + 1):
        step(poses, done)
    late = seen.frames_among(range(FRAMES // 2, FRAMES))
    before, after = (seen.losses(pose[late], late).mean() for pose in (wrong.pose, poses.all()))
    assert after < 0.9 * before, (before, after)


def test_a_face_that_the_given_pose_contradicts_counts_no_more_than_none(video, built_in_body):
    pixels, wrong = video.landmarks.pixels.copy(), 7
    pixels[wrong, len(BODY_LANDMARKS) :] += (60, 20)  # the face is seen elsewhere
    landmarks = replace(video.landmarks, pixels=pixels)
    moved = SimpleNamespace(**vars(video) | {"landmarks": landmarks})
    seen, right = (
        TrainingLandmarks.of(moved, built_in_body),
        TrainingLandmarks.of(video, built_in_body),
    )
    assert (
        not seen.evidence.scale[wrong, -len(NOSE_AND_EYES) :].any()
        and seen.evidence.scale[wrong].any()
    )
    others = [k for k in range(FRAMES) if k != wrong]
    assert torch.equal(seen.evidence.scale[others], right.evidence.scale[others])
    assert (seen.offsets - right.offsets).abs().max() < 0.0005


def test_test_frames_tell_nothing_and_a_video_without_landmarks_has_none(video, built_in_body):
    seen = TrainingLandmarks.of(video, built_in_body)
    assert seen.frames_among(range(FRAMES)) == list(video.splits.train)
    assert seen.losses(Pose.rest(1), [TEST]) == 0
    nothing = SimpleNamespace(**vars(video) | {"landmarks": None})
    assert TrainingLandmarks.of(nothing, built_in_body) is None


def test_a_video_whose_training_frames_show_nobody_has_no_offsets(video, built_in_body):
    none = SimpleNamespace(**vars(video) | {"splits": Splits([], list(range(FRAMES)))})
    seen = TrainingLandmarks.of(none, built_in_body)
    assert not seen.frames_among(range(FRAMES)) and not seen.offsets.any()


def test_smaller_pictures_give_the_same_losses(video, wrong, built_in_body):
    half = CAMERA.resized(CAMERA.width // 2, CAMERA.height // 2)
    small = {"landmarks": video.landmarks.downscaled(2), "cameras": [half] * FRAMES}
    found = []
    for seen in (video, SimpleNamespace(**vars(video) | small)):
        landmarks = TrainingLandmarks.of(seen, built_in_body)
        counts = landmarks.evidence.counts.clone()
        counts[-len(NOSE_AND_EYES) :] = 0  # the face's standard deviation has a part in pixels
        landmarks.evidence = replace(landmarks.evidence, counts=counts)
        found.append(landmarks.losses(wrong.pose, range(FRAMES)))
    torch.testing.assert_close(*found, rtol=1e-3, atol=1e-4)


def test_a_resumed_training_has_the_offsets_of_the_one_that_was_stopped(wrong, built_in_body):
    rig, steps, kill = Rig.of(built_in_body, wrong.shape), 60, 40  # after both updates
    given = wrong.pose, wrong.cameras, rig, PoseOptions(every=1), steps

    def start():
        seen = TrainingLandmarks.of(wrong, built_in_body)
        return TrainedPoses(*given, as_given=True, seen=seen)

    whole, killed, resumed = start(), start(), start()
    for done in range(1, steps + 1):
        step(whole, done)
    for done in range(1, kill + 1):
        step(killed, done)
    resumed.load_state(killed.state())
    for done in range(kill + 1, steps + 1):
        step(resumed, done)
    assert torch.equal(resumed.all().rotations, whole.all().rotations)
