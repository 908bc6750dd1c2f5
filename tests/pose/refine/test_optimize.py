"""The optimisation, on evidence that needs no images."""

from dataclasses import replace

import pytest
import torch

from gva_mi.body.pose import JOINTS, Pose
from gva_mi.prior.anatomy import Anatomy
from gva_mi.prior.error_model import stage1_errors
from gva_mi.refine import SequenceOptions
from gva_mi.refine.optimize import descend, worse_frames

ARMS = torch.full((55,), 0.3)
ELBOW = JOINTS.index("left_elbow")
FREE = SequenceOptions(
    prior_weight=1e-9, learn=0, passes=200, batch=2, step=0.01, translation_lr=0.01
)  # nothing but the evidence counts
PLACE = torch.tensor([0.1, -0.2, 0.05])  # where the person stands, apart from what is shared
SHARED = torch.tensor([0.0, 0.3, 0.0])


class Places:
    """Evidence of the person's position and elbow; perhaps of a shared offset."""

    anatomy = Anatomy.of(torch.zeros(55, 3))  # all joints in one point: none is held
    soles, unseen, distance_shown, surface_known = None, (), False, False

    def __init__(self, camera, frames=(0, 1, 3), share=False):
        self.frames, self.camera, self.visited = frames, camera, []
        self.offset = torch.zeros(1, 3, requires_grad=share)
        self.shared = [(self.offset, 0.02)] if share else []

    def loss(self, frames, pose):
        self.visited.append(list(frames))
        away = pose.transl - PLACE - (SHARED if self.shared else 0)
        bent = pose.rotations[:, ELBOW, 1] - 0.2
        return ((away + self.offset).square().sum(1) + bent.square()).mean()

    def enable_details(self):
        self.closer_at = len(self.visited)

    def energy(self):
        return (self.offset - SHARED).square().sum() if self.shared else 0.0


def test_frames_with_evidence_follow_it_and_the_others_stay(camera):
    start, there = Pose.rest(5), [0, 1, 3]
    found = descend(Places(camera), start, ARMS, FREE).pose
    torch.testing.assert_close(found.transl[there], PLACE.expand(3, 3), atol=5e-3, rtol=0)
    bent = found.rotations[there, ELBOW, 1]
    torch.testing.assert_close(bent, torch.full((3,), 0.2), atol=5e-3, rtol=0)
    assert torch.equal(found.transl[[2, 4]], start.transl[[2, 4]])
    assert torch.equal(found.rotations[[2, 4]], start.rotations[[2, 4]])


def test_shared_unknowns_are_found_too(camera):
    evidence = Places(camera, share=True)
    found = descend(evidence, Pose.rest(4), ARMS, FREE).pose
    torch.testing.assert_close(evidence.offset.detach()[0], SHARED, atol=5e-3, rtol=0)
    torch.testing.assert_close(found.transl[0], PLACE, atol=1e-2, rtol=0)


def test_a_pass_visits_every_frame_once_in_an_order_of_the_seed(camera):
    orders, calls = [], []
    for seed in (0, 0, 1):
        evidence = Places(camera, frames=range(7))
        options = replace(FREE, passes=3, batch=3, seed=seed)
        descend(evidence, Pose.rest(7), ARMS, options, lambda *a, **kw: calls.append(a))
        assert [len(batch) for batch in evidence.visited] == [3, 2, 2] * 3
        for first in (0, 3, 6):
            assert sorted(sum(evidence.visited[first : first + 3], [])) == list(range(7))
        orders.append(evidence.visited)
    assert orders[0] == orders[1] != orders[2]
    assert calls[:9] == [(step, 9) for step in range(1, 10)]


def test_a_loss_that_grew_or_is_nan_is_worse():
    before, after = torch.tensor([1.0, 1.0, 1.0, 2.0]), torch.tensor([1.0, 1.5, torch.nan, 1.0])
    assert worse_frames([0, 1, 2, 3], before, after) == {
        1: "its loss grew from 1.000 to 1.500",
        2: "its loss grew from 1.000 to nan",
    }
    assert list(worse_frames([0, 1, 2, 3], before, after, margin=0.5)) == [2]
    assert worse_frames([1], before, after, digits=1) == {1: "its loss grew from 1.0 to 1.5"}


def test_held_out_frames_follow_the_motion(camera):
    evidence = Places(camera, frames=(0, 1, 2, 4, 5, 6))
    found = descend(
        evidence, Pose.rest(7), ARMS, replace(FREE, prior_weight=1e-6), filled_in=[3]
    ).pose
    assert 3 not in sum(evidence.visited, [])
    torch.testing.assert_close(found.transl[3], PLACE, atol=4e-2, rtol=0)
    assert float(found.rotations[3, ELBOW, 1]) == pytest.approx(0.2, abs=0.03)


def test_unseen_joints_stay_and_details_follow_after_the_learning_passes(camera):
    evidence = Places(camera)
    evidence.unseen = (ELBOW,)
    found = descend(evidence, Pose.rest(4), ARMS, replace(FREE, learn=4)).pose
    torch.testing.assert_close(found.transl[0], PLACE, atol=5e-3, rtol=0)
    assert torch.equal(found.rotations[:, ELBOW], torch.zeros(4, 3))
    assert evidence.closer_at == 4 * 2  # two batches of a pass


class TruePlaces(Places):
    """Evidence of a position for each frame."""

    def __init__(self, camera, places):
        super().__init__(camera, range(len(places)))
        self.places = places

    def loss(self, frames, pose):
        return (pose.transl - self.places[frames]).square().sum(1).mean()


def test_start_poses_that_agree_better_than_the_map_estimate_are_kept(camera):
    start = Pose.rest(12)
    start.transl[:] = 0.1 * torch.randn(12, 3, generator=torch.Generator().manual_seed(0))
    hardly = replace(FREE, passes=1, step=1e-6, translation_lr=1e-6)
    first = lambda true, **kw: (
        descend(TruePlaces(camera, true), start, ARMS, hardly, **kw).pose.transl
    )
    away = lambda found, true: (found - true).norm(dim=1).mean()
    right = start.transl.clone()  # the person jumps
    assert away(first(right, try_uncorrected=True), right) < 1e-4 < 0.02 < away(first(right), right)
    smooth = right * 0  # the jumps are errors
    assert torch.equal(first(smooth, try_uncorrected=True), first(smooth))
    assert away(first(smooth), smooth) < away(start.transl, smooth)


class Bent(Places):
    """Evidence of the elbow's angle in each frame."""

    def __init__(self, camera, angles):
        super().__init__(camera, range(len(angles)))
        self.angles = angles

    def loss(self, frames, pose):
        return 10 * (pose.rotations[:, ELBOW, 1] - self.angles[frames]).square().mean()


def test_a_fast_gesture_is_no_error_of_a_known_estimator_if_the_images_show_it(camera):
    start, hardly = Pose.rest(24), replace(FREE, passes=1, step=1e-6, translation_lr=1e-6)
    start.rotations[10:15, ELBOW, 1] = torch.tensor([0.7, 1.4, 1.6, 1.4, 0.7])
    errors = {"known_errors": stage1_errors(fps=8.0)}
    first = lambda angles: descend(Bent(camera, angles), start, ARMS, hardly, **errors).pose
    peak = lambda angles: float(first(angles).rotations[12, ELBOW, 1])
    assert peak(0 * start.rotations[:, ELBOW, 1]) < 1.1  # the images show none
    assert peak(start.rotations[:, ELBOW, 1]) > 1.4
