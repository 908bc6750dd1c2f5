"""Photometric tracking recovers known poses from pictures of a known avatar."""

from concurrent.futures import Future
from dataclasses import replace

import drjit as dr
import pytest
import torch

from gva_mi.body.pose import JOINTS, Pose
from gva_mi.core.tasks import Helpers
from gva_mi.fit.photometric import PhotometricOptions, fit_poses

ELBOW, JAW = JOINTS.index("left_elbow"), JOINTS.index("jaw")
OPTIONS = PhotometricOptions(passes=12, prior_weight=1e-6, step=0.015, translation_lr=0.015)
SHORT = replace(OPTIONS, passes=2)
SHIFT = torch.tensor([0.04, -0.03, 0.0])


def off(pose, frames, turn=0.0):
    """The pose with a shift and a bent elbow in some frames."""
    rotations, transl = pose.rotations.clone(), pose.transl.clone()
    transl[frames] += SHIFT
    rotations[frames, ELBOW, 1] += turn
    return Pose(rotations, transl, pose.expression)


def same(a, b, frames=slice(None)):
    rotations = torch.equal(a.rotations[frames], b.rotations[frames])
    return rotations and torch.equal(a.transl[frames], b.transl[frames])


@pytest.fixture(scope="module")
def wrong(video):
    """The video under poses that are off in every frame."""
    return replace(video, pose=off(video.pose, slice(None), turn=0.3))


@pytest.fixture(scope="module")
def fitted(known, wrong):
    return fit_poses(known, wrong, OPTIONS)


def test_a_known_error_is_found(fitted, known, wrong, video, camera):
    """On the picture: what one camera does not see, such as depth, need not come back."""
    pixels = lambda pose: torch.from_numpy(camera.project(known(pose).means.double().numpy()))
    for k in range(len(video)):
        with torch.no_grad():
            true, before, after = (pixels(p[k]) for p in (video.pose, wrong.pose, fitted.pose))
        assert (after - true).norm(dim=1).mean() < 0.4 * (before - true).norm(dim=1).mean()
    assert (fitted.losses < 0.5 * fitted.losses_before).all() and not fitted.kept


def test_the_same_options_give_the_same_bits_on_any_number_of_threads(known, wrong):
    first = fit_poses(known, wrong, SHORT).pose
    of_torch, of_drjit = torch.get_num_threads(), dr.thread_count()
    try:
        for count in (1, 2):
            torch.set_num_threads(count)
            dr.set_thread_count(count)
            assert same(fit_poses(known, wrong, SHORT).pose, first)
    finally:
        torch.set_num_threads(of_torch)
        dr.set_thread_count(of_drjit)


class Inline:
    """An executor that works at once, in this process."""

    def submit(self, function, *given):
        future = Future()
        future.set_result(function(*given))
        return future


def test_helpers_that_share_frames_find_the_same_bits(known, wrong):
    """In steps of three frames, whose gradients are thirds."""
    options = replace(SHORT, batch=3)
    alone = fit_poses(known, wrong, options)
    shared = fit_poses(known, wrong, options, helpers=Helpers([Inline()]))
    assert same(alone.pose, shared.pose) and torch.equal(alone.losses, shared.losses)


def test_a_pose_that_is_right_stays(known, video):
    found = fit_poses(known, video, PhotometricOptions(passes=3))
    assert (found.pose.transl - video.pose.transl).abs().max() < 2e-3
    assert (found.losses <= found.losses_before).all()


def test_frames_without_evidence_keep_their_pose_and_are_listed(known, wrong):
    pose = wrong.pose.map(torch.clone)
    pose.transl[2] += torch.tensor([50.0, 0, 0])
    pose.transl[4] += torch.tensor([0, 0, 50.0])
    video = replace(wrong, pose=pose, absent={0: "it has no picture"})
    found = fit_poses(known, video, SHORT)
    assert {0: "it has no picture", 2: "its avatar is out of view"}.items() <= found.kept.items()
    assert "behind the camera" in found.kept[4]
    assert same(found.pose, pose, [0, 2, 4]) and not same(found.pose, pose, [1])
    assert found.losses[[0, 2, 4]].isnan().all()


def test_a_frame_whose_loss_increased_keeps_its_pose(known, video):
    wild = replace(OPTIONS, passes=1, step=10.0, largest_turn=3.0, translation_lr=1.0)
    found = fit_poses(known, video, wild)
    assert set(found.kept) == set(range(len(video))) and "its loss grew" in found.kept[0]
    assert same(found.pose, video.pose) and torch.equal(found.losses, found.losses_before)


def test_a_long_video_is_fitted_in_clips(known, wrong):
    seen = []
    options = replace(SHORT, part=4, overlap=1)
    found = fit_poses(
        known, wrong, options, progress=lambda done, total, **_: seen.append((done, total))
    )
    assert seen[-1][0] == seen[-1][1] and [done for done, _ in seen] == list(
        range(1, len(seen) + 1)
    )
    assert not same(found.pose, fit_poses(known, wrong, SHORT).pose)
    assert (found.losses < found.losses_before).all()


def test_only_the_requested_frames_are_read_and_moved(known, wrong, monkeypatch):
    read, of = [], type(wrong).__getitem__
    monkeypatch.setattr(type(wrong), "__getitem__", lambda self, k: read.append(k) or of(self, k))
    found = fit_poses(known, wrong, SHORT, frames=[3, 1])
    moved = (found.pose.transl != wrong.pose.transl).any(1).tolist()
    assert set(read) == {1, 3} and moved == [k in (1, 3) for k in range(6)]
    assert found.losses.isfinite().tolist() == moved
