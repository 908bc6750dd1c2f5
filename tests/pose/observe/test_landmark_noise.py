"""Standard deviations of landmarks: sizes in pixels scale with the picture, gaps are infinite."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gva_mi.core.errors import InputError
from gva_mi.observe.landmark_noise import (
    ALONG_LIMB,
    HIDDEN_FACE,
    LandmarkNoise,
    correlated_frames,
    median_sizes,
    misplaced_frames,
    person_sizes,
    size_misfits,
)
from gva_mi.observe.rig import LandmarkRig
from gva_mi.subject.landmarks import BODY_LANDMARKS, Landmarks, hand_names

PARTS = ("pixels", "confidence", "spread", "metric")


@pytest.fixture(scope="module")
def standing(built_in_body):
    """The built-in body from the front, 200 pixels a metre, in three frames."""
    rig = LandmarkRig.of(
        built_in_body, (*BODY_LANDMARKS, *hand_names("left"), *hand_names("right"))
    )
    metric = (rig.rest * torch.tensor([1.0, -1, -1])).numpy()[None].repeat(3, 0)
    ones = np.ones(metric.shape[:2])
    return Landmarks(rig.names, 200 * metric[..., :2] + 300, ones, 0 * ones, metric)


def test_a_video_without_a_person_is_refused(standing):
    with pytest.raises(InputError, match="no frame has a person"):
        person_sizes(replace(standing, pixels=standing.pixels * np.nan))


def test_noise_scales_with_the_picture_and_grows_with_doubt(standing):
    names = standing.names
    usual = LandmarkNoise.of(standing, names)
    larger = LandmarkNoise.of(replace(standing, pixels=2 * standing.pixels), names)
    assert torch.allclose(larger.pixels, 2 * usual.pixels)
    assert torch.equal(larger.depth, usual.depth)
    spread = replace(standing, spread=np.full_like(standing.confidence, 3.0))
    assert (LandmarkNoise.of(spread, names).pixels > usual.pixels).all()
    unsure = replace(standing, confidence=0.6 * standing.confidence)
    doubted = LandmarkNoise.of(unsure, names)
    assert torch.allclose(doubted.pixels, usual.pixels / 0.6)
    assert torch.equal(doubted.depth, usual.depth)


def test_a_person_who_comes_nearer_has_no_misfit_and_one_who_shrinks_for_some_frames_has():
    t = np.arange(60)
    for sizes in (300.0 + 0 * t, 300.0 + t):
        assert not size_misfits(sizes).any() and np.allclose(median_sizes(sizes), sizes)
        wrong = sizes.copy()
        wrong[20:32] *= 0.8
        found = size_misfits(wrong)
        assert (found[20:32] > 0.1 * sizes[20:32]).all()
        assert (np.delete(found, range(14, 38)) < 0.03 * sizes.min()).all()
    noise = np.random.default_rng(0).normal(0, 0.02, 60)  # which is usual in this video
    assert (size_misfits(300 * (1 + noise)) > 0).mean() < 0.05


def test_in_a_frame_that_does_not_fit_pixels_and_depths_err_more(standing):
    some = [0] * 8 + [1] + [2] * 8
    long = replace(standing, **{k: getattr(standing, k)[some] for k in PARTS})
    usual, wrong = LandmarkNoise.of(long, long.names), replace(long, pixels=long.pixels.copy())
    wrong.pixels[8] = 300 + 0.95 * (wrong.pixels[8] - 300)  # 5 % smaller
    found = LandmarkNoise.of(wrong, long.names)
    assert misplaced_frames(wrong) == []
    assert (found.pixels[8] > 1.5 * usual.pixels[8]).all()
    assert (found.depth[8] > usual.depth[8]).all()
    assert torch.equal(found.pixels[:8], usual.pixels[:8])
    wrong.pixels[8] = 300 + 0.9 * (wrong.pixels[8] - 300)
    assert misplaced_frames(wrong) == [8]
    assert misplaced_frames(wrong.without([8])) == []  # nobody was seen there


def test_a_missing_landmark_is_infinitely_uncertain_and_so_are_its_bones(standing):
    k = standing.names.index("left_wrist")
    lost = replace(standing, pixels=standing.pixels.copy())
    lost.pixels[1, k] = np.nan
    noise = LandmarkNoise.of(lost, standing.names)
    assert noise.pixels[1, k].isinf() and noise.pixels.isfinite().sum() == 3 * 75 - 1
    touching = (noise.bones == k).any(1)
    assert touching.sum() == 3
    assert torch.equal(noise.depth[1].isinf(), touching) and noise.depth[[0, 2]].isfinite().all()


def test_a_face_that_is_turned_away_errs_more(standing):
    """Frame 0 from the front, 1 from the side, 2 from behind; elsewhere nothing changes."""
    turned = replace(standing, metric=standing.metric.copy())
    face = np.arange(len(standing.names)) < BODY_LANDMARKS.index("left_shoulder")
    x, y, z = np.moveaxis(standing.metric[:, face], -1, 0)
    turned.metric[1, face] = np.stack([-z, y, x], -1)[1]
    turned.metric[2, face] = np.stack([-x, y, -z], -1)[2]
    factors = (
        LandmarkNoise.of(turned, standing.names).pixels[:, face]
        / (LandmarkNoise.of(standing, standing.names).pixels[:, face])
    )
    expected = torch.tensor([1, 1 + (HIDDEN_FACE - 1) / 3, HIDDEN_FACE])[:, None]
    torch.testing.assert_close(factors, expected.expand_as(factors), rtol=0.15, atol=0)
    unknown = replace(standing, metric=standing.metric.copy())
    unknown.metric[:, face] = np.nan
    assert LandmarkNoise.of(unknown, standing.names).pixels.isfinite().all()


def test_a_hand_away_from_the_wrist_errs_by_as_much(standing):
    """The tracker stayed 0.3 m beside the wrist in one frame: the hand alone is doubted, there."""
    moved = replace(standing, pixels=standing.pixels.copy())
    hand = [k for k, name in enumerate(standing.names) if name.startswith("left_hand_")]
    moved.pixels[1, hand, 0] += 60
    usual, noise = (LandmarkNoise.of(x, standing.names) for x in (standing, moved))
    assert (noise.pixels[1, hand] - 60).abs().max() < 1.0
    of_hand = torch.isin(noise.bones, torch.tensor(hand)).any(1)
    assert (noise.depth[1, of_hand] > 0.29).all()
    noise.pixels[1, hand], noise.depth[1, of_hand] = usual.pixels[1, hand], usual.depth[1, of_hand]
    assert torch.equal(noise.pixels, usual.pixels) and torch.equal(noise.depth, usual.depth)


def test_the_ends_of_a_limb_slide_along_it(standing):
    names = list(standing.names)
    arm = ("shoulder", "elbow", "wrist")
    shoulder, elbow, wrist = (names.index(f"left_{name}") for name in arm)
    end_on = replace(standing, pixels=standing.pixels.copy())
    end_on.pixels[1, wrist] = end_on.pixels[1, elbow]
    noise = LandmarkNoise.of(end_on, names)
    precision = noise.whitening @ noise.whitening  # σ² Σ⁻¹
    limb = torch.from_numpy(standing.pixels[0, elbow] - standing.pixels[0, shoulder]).float()
    u = limb / limb.norm()
    across = u.flip(0) * torch.tensor([1.0, -1.0])
    for point in (shoulder, elbow):
        assert torch.allclose(precision[0, point] @ u, u / ALONG_LIMB**2)
        assert torch.allclose(precision[0, point] @ across, across)
    round_ = (precision == torch.eye(2)).all((2, 3))
    assert round_[1, wrist] and not round_[0, wrist]
    ends = ("shoulder", "elbow", "wrist", "hip", "knee", "ankle")
    slide = [name.endswith(ends) and "hand" not in name for name in names]
    assert torch.equal(~round_[0], torch.tensor(slide))


def test_frames_that_look_alike_count_as_one(standing):
    pixels = standing.pixels.repeat(2, 0)  # six frames
    pixels[3:, standing.names.index("left_wrist"), 0] += 200  # a metre aside
    pixels[2] = 2 * pixels[2] - 150  # nearer, and at another place
    pixels[5] = np.nan
    recording = replace(standing, pixels=pixels, confidence=standing.confidence.repeat(2, 0),
        spread=standing.spread.repeat(2, 0), metric=standing.metric.repeat(2, 0))  # fmt: skip
    alike = correlated_frames(recording, dt=1.0)
    assert alike[:3].numpy() == pytest.approx([3, 3, 3], abs=1e-3)
    assert alike[3:5].numpy() == pytest.approx([2, 2], abs=1e-3)
    assert correlated_frames(recording, dt=0.02)[3] == 5  # a tenth of a second
