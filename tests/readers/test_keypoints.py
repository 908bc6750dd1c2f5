"""Keypoints of OpenPose, MMPose and AlphaPose take the place of a network's landmarks."""

import json

import numpy as np
import pytest

from gva_mi.core.errors import InputError
from gva_mi.readers.keypoints import LAYOUTS, with_keypoints
from gva_mi.subject.landmarks import BODY_LANDMARKS, Landmarks, hand_names

FRAMES = 6
NAMES = (*BODY_LANDMARKS, *hand_names("left"), *hand_names("right"))


@pytest.fixture
def person():
    """Where all named points of one person are (T, P, 2), pixels, and what a network says."""
    random = np.random.default_rng(5)
    points = 200 + 100 * random.random((1, len(NAMES), 2)) + 5 * np.arange(FRAMES)[:, None, None]
    near = points + random.normal(size=points.shape)
    confidence = np.full(points.shape[:2], 0.9)
    metric = random.normal(size=(*points.shape[:2], 3))
    return points, Landmarks(NAMES, near, confidence, 0.3 * confidence, metric)


def named(points, t, name):
    return points[t, NAMES.index(name)] - 0.5  # the first pixel's centre is at 0 in these files


def row_of(points, t, layout, score=0.8):
    """x, y, score of each point of a layout; 0 where it is of none of our names."""
    found = [[*named(points, t, n), score] if n else [1.0, 1.0, score] for n in LAYOUTS[layout]]
    return np.ravel(found).tolist()


def openpose(path, points, offset=0):
    path.mkdir()
    for t in range(FRAMES):
        hands = {
            f"hand_{side}_keypoints_2d": np.ravel(
                [[*named(points, t, n), 0.7] for n in hand_names(side)]
            ).tolist()
            for side in ("left", "right")
        }
        stranger = {"pose_keypoints_2d": row_of(points + 300, t, 25), "face_keypoints_2d": []}
        own = {"pose_keypoints_2d": row_of(points, t, 25)} | hands
        text = json.dumps({"version": 1.3, "people": [stranger, own]})
        (path / f"walk_2_{t + offset:012d}_keypoints.json").write_text(text)


def mmpose(path, points):
    def instance(t, away):
        rows = np.reshape(row_of(points + away, t, 133), (133, 3))
        return {"keypoints": rows[:, :2].tolist(), "keypoint_scores": rows[:, 2].tolist(),
                "bbox": [[0, 0, 1, 1]]}  # fmt: skip

    frames = [{"frame_id": t + 1, "instances": [instance(t, 300), instance(t, 0)]}
              for t in range(FRAMES)]  # fmt: skip
    path.write_text(json.dumps({"meta_info": {}, "instance_info": frames}))


def alphapose(path, points):
    found = [{"image_id": f"{t}.jpg", "keypoints": row_of(points, t, 26), "score": 2.9}
             for t in range(FRAMES)]  # fmt: skip
    path.write_text(json.dumps(found))


@pytest.mark.parametrize(
    "write, layout, hands", [(openpose, 25, 0.7), (mmpose, 133, 0.8), (alphapose, 26, 0)]
)
def test_points_lie_where_the_file_says(tmp_path, person, write, layout, hands):
    points, network = person
    write(tmp_path / "k", points)
    found, notes = with_keypoints(network, tmp_path / "k", range(FRAMES), 1.0)
    body = [NAMES.index(name) for name in LAYOUTS[layout] if name in BODY_LANDMARKS]
    assert np.abs(found.pixels[:, body] - points[:, body]).max() < 1e-9
    assert (found.confidence[:, body] == 0.8).all() and not found.spread[:, body].any()
    wrists = [NAMES.index(name) for name in hand_names("right")]
    if hands:
        assert np.abs(found.pixels[:, wrists] - points[:, wrists]).max() < 1e-9
    assert (found.confidence[:, wrists] == hands).all()
    untold = [NAMES.index(name) for name in ("left_pinky", "mouth_left")]  # of none of them
    assert (found.pixels[:, untold] == network.pixels[:, untold]).all()
    assert (found.metric == network.metric).all()
    found.save(tmp_path / "landmarks.npz")
    kept = Landmarks.load(tmp_path / "landmarks.npz").at_joints
    assert {"left_knee", "right_ankle"} <= set(kept) and "mouth_left" not in kept
    assert notes == [f"keypoints of {tmp_path / 'k'} in 6 of 6 frames"]


def test_missing_points_and_frames_stay_missing(tmp_path, person):
    points, network = person
    openpose(tmp_path / "k", points)
    files = sorted((tmp_path / "k").iterdir())
    files[2].write_text(json.dumps({"people": []}))
    content = json.loads(files[1].read_text())
    content["people"][1]["pose_keypoints_2d"][:3] = [0, 0, 0]
    files[1].write_text(json.dumps(content))
    found, notes = with_keypoints(network, tmp_path / "k", range(FRAMES), 1.0)
    assert np.isnan(found.pixels[1, 0]).all() and found.confidence[1, 0] == 0
    wrist = NAMES.index("left_wrist")
    assert np.isnan(found.pixels[2, wrist]).all() and np.isfinite(found.pixels[3, wrist]).all()
    assert "in 5 of 6 frames" in notes[0]


def test_keypoints_that_do_not_fit_are_described(tmp_path, person):
    points, network = person
    alphapose(tmp_path / "far.json", points + 900)
    (tmp_path / "few.json").write_text(json.dumps([{"image_id": 0, "keypoints": [1.0] * 27}]))
    (tmp_path / "none.json").write_text("[]")
    (tmp_path / "still.json").write_text(json.dumps([{"keypoints": row_of(points, 0, 17)}]))
    for name, words in (
        ("far", "do not lie on the person of the video; expected keypoints of"),
        ("few", "a person has 9 points; expected 17, 18, 25, 26, 133, 136"),
        ("none", "holds no people; expected keypoints of OpenPose"),
        ("still", "unexpected format .*expected keypoints"),
        ("nowhere", "nowhere.json: no such file"),
    ):
        with pytest.raises(InputError, match=words):
            with_keypoints(network, tmp_path / f"{name}.json", range(FRAMES), 1.0)
