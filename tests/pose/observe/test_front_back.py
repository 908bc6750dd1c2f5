"""Frames in which a network takes the back for the front are found, and nothing else is."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from gva_mi.body.pose import mirrored_name
from gva_mi.networks.video_landmarks import WatchedVideo
from gva_mi.observe.swaps import LIMB_POINTS, fix_front_back
from gva_mi.stage1 import prepare
from gva_mi.subject.landmarks import BODY_LANDMARKS, FACE_LANDMARKS, Landmarks, hand_names

NAMES = (*BODY_LANDMARKS, *hand_names("left"), *hand_names("right"), *FACE_LANDMARKS)
N, FPS = 60, 30.0
PLACES = {  # half the distance between left and right, and height, of a person of 400 pixels
    "shoulder": (45, 330), "elbow": (70, 260), "wrist": (90, 200), "hip": (30, 200),
    "knee": (28, 100), "ankle": (25, 0),
}  # fmt: skip
BACK = range(26, 37)


def turning(rounds=1.0):
    """Landmarks of a person who turns round and swings the arms; noise of 3 pixels."""
    rng, turn = np.random.default_rng(0), 2 * np.pi * rounds * np.arange(N) / N
    pixels = np.tile(np.array([300.0, 100.0]), (N, len(NAMES), 1))
    swing = 20 * np.sin(2 * np.pi * np.arange(N) / 25)
    for part in LIMB_POINTS:
        wide, high = PLACES[part]
        for side, sign in (("left", 1), ("right", -1)):
            at = NAMES.index(f"{side}_{part}")
            ahead = swing * sign * (part == "wrist")
            pixels[:, at, 0] += sign * wide * np.cos(turn) + ahead * np.sin(turn)
            pixels[:, at, 1] = 500 - high
    pixels += rng.normal(0, 3, pixels.shape)
    metric = rng.normal(0, 0.3, (N, len(NAMES), 3))
    metric[..., :2] = (pixels - 300) / 235
    face = [NAMES.index(name) for name in FACE_LANDMARKS]
    hidden = np.flatnonzero(np.cos(turn) < 0.3)
    pixels[np.ix_(hidden, face)] = metric[np.ix_(hidden, face)] = np.nan
    confidence = rng.uniform(0.5, 1, pixels.shape[:2])
    return Landmarks(NAMES, pixels, confidence, 1 - confidence, metric)


def exchanged(landmarks, frames):
    """The landmarks with left and right exchanged in some frames."""
    order = [NAMES.index(mirrored_name(name)) for name in NAMES]
    fields = {}
    for name in ("pixels", "confidence", "spread", "metric"):
        fields[name] = getattr(landmarks, name).copy()
        fields[name][frames] = fields[name][frames][:, order]
    return Landmarks(NAMES, **fields)


@pytest.mark.parametrize("frames", [BACK, range(30, 31), [*range(20, 24), *range(33, 40)]])
def test_frames_that_take_the_back_for_the_front_are_exchanged_without_their_depths(frames):
    true, frames = turning(), list(frames)
    found, mistaken = fix_front_back(exchanged(true, frames), FPS)
    assert mistaken == frames
    for name in ("pixels", "confidence", "spread"):
        np.testing.assert_array_equal(getattr(found, name), getattr(true, name))
    others = np.setdiff1d(np.arange(N), frames)
    assert np.isnan(found.metric[frames]).all()
    np.testing.assert_array_equal(found.metric[others], true.metric[others])


@pytest.mark.parametrize("rounds", [0.0, 0.5, 1.0, 3.0])
def test_a_person_who_turns_even_quickly_stays_as_seen(rounds):
    true = turning(rounds)
    found, mistaken = fix_front_back(true, FPS)
    assert mistaken == [] and found is true


@pytest.mark.parametrize("fps", [10.0, 30.0, 60.0])
def test_the_face_tells_where_no_limb_jumps(fps):
    """From one profile on, and in most frames, the network sees a front that has no face."""
    true = turning(0.5)
    hidden = list(range(29, N))
    found, mistaken = fix_front_back(exchanged(true, hidden), fps)
    wrong = set(mistaken) ^ set(hidden)
    assert wrong <= set(range(27, 34)), mistaken  # left and right are nearly in one place there
    _, mistaken = fix_front_back(true, fps)
    assert mistaken == []


def test_a_video_that_never_shows_a_face_says_nothing_by_its_absence():
    true = turning(0.0)
    true.pixels[:, [NAMES.index(name) for name in FACE_LANDMARKS]] = np.nan
    assert fix_front_back(true, FPS)[1] == []


def test_the_solver_gets_corrected_landmarks_and_the_user_is_told(monkeypatch):
    true, solved = turning(), []
    wrong = WatchedVideo(exchanged(true, list(BACK)), ["too dark"])
    pictures = SimpleNamespace(pictures=[np.zeros((4, 4, 3))], focal35=26, fps=FPS, notes=[])
    monkeypatch.setattr(prepare, "even_pictures", lambda *_: pictures)
    monkeypatch.setattr(prepare, "watch_video", lambda *_: wrong)
    monkeypatch.setattr(prepare, "solve_stage1", lambda found, *_, **__: solved.append(found))
    monkeypatch.setattr(prepare, "with_face", lambda *_: (None, []))
    motion = prepare.motion_of_video(Path("video.mp4"), prepare.PrepareVideoOptions(), None)
    np.testing.assert_array_equal(solved[0].pixels, true.pixels)
    assert motion.watched.landmarks is solved[0]
    assert motion.notes[0] == "too dark" and "26-36" in motion.notes[1], motion.notes


def test_frames_in_which_the_network_misplaced_the_person_tell_nothing(monkeypatch):
    true, wrong, solved, silhouettes = turning(), [20, 21, 22], [], {}
    seen = replace(true, pixels=true.pixels.copy())
    seen.pixels[wrong] *= 0.8
    pictures = SimpleNamespace(pictures=[np.zeros((4, 6, 3))], focal35=26, fps=FPS, notes=[])
    monkeypatch.setattr(prepare, "even_pictures", lambda *_: pictures)
    monkeypatch.setattr(prepare, "watch_video", lambda *_: WatchedVideo(seen, []))
    monkeypatch.setattr(prepare, "solve_stage1", lambda found, *_, **__: solved.append(found))
    monkeypatch.setattr(prepare, "with_face", lambda *_: (None, []))
    given = Path("video.mp4"), prepare.PrepareVideoOptions(), None
    motion = prepare.motion_of_video(*given, on_silhouette=silhouettes.__setitem__)
    assert np.isnan(solved[0].pixels[wrong]).all() and not solved[0].confidence[wrong].any()
    others = np.setdiff1d(np.arange(len(true)), wrong)
    np.testing.assert_array_equal(solved[0].pixels[others], true.pixels[others])
    assert "20-22" in motion.notes[0] and sorted(silhouettes) == wrong
    assert all(inside.shape == (4, 6) and not inside.any() for inside in silhouettes.values())
