"""What a video lacks is named, with a figure and what to do; a good video has no findings."""

import numpy as np
import pytest
import torch
from scipy.ndimage import uniform_filter1d

from gva_mi.body.pose import Pose, Shape, save_poses
from gva_mi.splat import Camera, look_at
from gva_mi.stage1 import video_check
from gva_mi.stage1.video_check import check_video
from gva_mi.subject.cameras import save_cameras
from gva_mi.subject.landmarks import BODY_LANDMARKS, Landmarks, hand_names
from gva_mi.subject.pictures import write_image
from gva_mi.subject.video import load_video

FRAMES, WIDE, TALL = 40, 320, 320
PERSON = np.s_[20:300, 120:200]  # rows and columns
# Shares of the person's box: columns of background between arms and trunk, in rows 0.3 to 0.6.
BESIDE = (0.12, 0.38), (0.62, 0.88)
# Landmarks that the check looks at: x, y.
SEEN = {"left_shoulder": (0.7, 0.25), "right_shoulder": (0.3, 0.25), "left_hip": (0.6, 0.6),
    "right_hip": (0.4, 0.6), "left_wrist": (0.95, 0.5), "right_wrist": (0.05, 0.5)}  # fmt: skip


@pytest.fixture
def recording(tmp_path, body):
    """Return a function that writes and checks a video: a textured box who turns round once."""
    rng = np.random.default_rng(0)
    tiles = (rng.random((TALL // 8, WIDE // 8 + 8, 3)).astype(np.float32) for _ in range(2))
    span = lambda start, stop: stop - start
    room, cloth = (tile.repeat(8, 0).repeat(8, 1) for tile in tiles)

    def checked(
        turn=1.0, person=PERSON, change=lambda image, k: image, slide=0, hands=1.0, apart=BESIDE,
        feet=1.0, **how,
    ):  # fmt: skip
        pose = Pose.rest(FRAMES)
        pose.rotations[:, 0, 1] = 2 * torch.pi * turn * torch.arange(FRAMES) / FRAMES
        save_poses(tmp_path / "poses.npz", pose, Shape(torch.zeros(10)), stage=1)
        camera = Camera(300, 300, WIDE / 2, TALL / 2, look_at((0, 0, 3), (0, 0, 0)), WIDE, TALL)
        save_cameras(tmp_path / "cameras.npz", [camera])
        mask = np.zeros((TALL, WIDE), np.float32)
        mask[person] = 1
        (top, left), (height, width) = ([f(x.start, x.stop) for x in person] for f in (min, span))
        for gap in apart:
            columns = slice(*(round(left + share * width) for share in gap))
            mask[round(top + 0.3 * height) : round(top + 0.6 * height), columns] = 0
        for k in range(FRAMES):
            at = k * slide // FRAMES
            image = np.where(mask[..., None] > 0, cloth[:, :WIDE], room[:, at : at + WIDE])
            write_image(tmp_path / f"frames/{k:06d}.png", change(image, k))
            write_image(tmp_path / f"masks/{k:06d}.png", mask)
        names = (*hand_names("left"), *hand_names("right"), *BODY_LANDMARKS)
        pixels = np.ones((FRAMES, len(names), 2))
        for name, place in SEEN.items():
            pixels[:, names.index(name)] = np.array([left, top]) + place * np.array([width, height])
        pixels[round(hands * FRAMES) :, :21] = np.nan  # of the left hand
        sure = np.ones(pixels.shape[:2])
        sure[round(feet * FRAMES) :, names.index("left_heel")] = 0.2
        sure[round(feet * FRAMES) :, names.index("left_foot_index")] = 0.3
        landmarks = Landmarks(names, pixels, sure, 0 * sure, np.zeros((*sure.shape, 3)))
        about = {"fps": 15.0} | how
        found = check_video(load_video(tmp_path), body, landmarks, **about)
        assert all(problem.remedy and problem.cause for problem in found)
        return {problem.what: (problem.figure, problem.frames) for problem in found}

    return checked


FAULTS = {  # of one video: what it is called, and what its figure says
    "never turned, too near, dark, in a crowd": (
        {"turn": 0.0, "person": np.s_[60:320, 120:200], "change": lambda image, k: image / 8,
         "crowded": (3, 4)},
        {"not seen from all sides": "never seen: left side, back, right side",
         "feet or legs cut off": "40 of 40 frames", "too dark": "of white",
         "several people": "2 of 40 frames"},
    ),
    "half turned, far away, short": (
        {"turn": 0.5, "person": np.s_[20:120, 120:160], "fps": 30.0},
        {"not seen from all sides": "240 of 360 degrees; never seen: left side",
         "few pixels": "100 pixels tall", "short video": "40 frames, 1.3 s"},
    ),
    "from a hand, without a hand": (
        {"slide": 9, "hands": 0.0},
        {"camera moves": "by up to 4 pixels", "left hand never seen": "0%"},
    ),
    "an arm at the body, a foot behind a chair": (
        {"apart": BESIDE[:1], "feet": 0.4},
        {"arms at the body": "left: apart in 0 of 40 frames", "feet hidden": "24 of 40 frames"},
    ),
}  # fmt: skip


def test_a_good_video_has_no_findings(recording):
    assert recording() == {}


def test_a_video_of_few_frames_is_not_called_short(recording, monkeypatch):
    monkeypatch.setattr(video_check, "SHORT_FRAMES", 41)
    ((what, (figure, _)),) = recording().items()
    assert (what, figure) == ("few frames", "40 in 2.7 s")


@pytest.mark.parametrize("name", FAULTS)
def test_each_fault_is_named_with_its_figure(recording, name):
    how, expected = FAULTS[name]
    found = recording(**how)
    assert found.keys() == expected.keys()
    assert all(expected[what] in figure for what, (figure, _) in found.items())


def test_blurred_frames_are_named(recording):
    blur = lambda image, k: uniform_filter1d(image, 9, axis=1) if 10 <= k < 20 else image
    ((what, (figure, frames)),) = recording(change=blur).items()
    assert what == "motion blur" and figure.endswith("of 24 sampled frames")
    assert set(frames) <= set(range(10, 20)) and len(frames) >= 5
