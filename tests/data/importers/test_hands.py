"""Hands of HaMeR, WiLoR and the like take the place of a body estimator's."""

import json
import pickle

import numpy as np
import pytest
import torch
from samples.rotations import matrices

from gva_mi.body.pose import JOINTS, LEFT_HAND, RIGHT_HAND
from gva_mi.body.rotations import to_rotvecs as vectors
from gva_mi.core.errors import InputError
from gva_mi.data.importers.hand_merge import merge_hands
from gva_mi.data.importers.people import pixels_by_frame
from gva_mi.data.importers.target import TargetBody
from gva_mi.data.importers.tracks import make_track
from gva_mi.data.video import load_video

FRAMES = 40
MIRRORED = np.diag([-1.0, 1.0, 1.0])
ELBOWS = {"left": (0, 3, 6, 9, 13, 16, 18), "right": (0, 3, 6, 9, 14, 17, 19)}  # from the root


@pytest.fixture
def body(walk):
    rotations, transl = walk(FRAMES)
    named = {"poses": rotations[:, :22].reshape(FRAMES, 66), "trans": transl + [0, 0, 4.0]}
    return make_track("body", "0", None, named, np.eye(3))


@pytest.fixture
def seen():
    """Fingers (2, T, 15, 3, 3), left and right, bent to the palm, and wrists (2, T, 1, 3, 3)."""
    random = np.random.default_rng(3)
    fingers = 0.2 * random.normal(size=(2, FRAMES, 15, 3))
    fingers[0, ..., :12, 2] -= 0.6
    fingers[1, ..., :12, 2] += 0.6
    return matrices(fingers), matrices(random.normal(size=(2, FRAMES, 1, 3)))


def as_right(seen):
    """What a network returns, which sees a left hand in a mirror."""
    return [np.stack([MIRRORED @ x[0] @ MIRRORED, x[1]]) for x in seen]


def hamer_folder(path, seen):
    """A file for each frame, numbered from 1, with the hands of a batch."""
    fingers, wrists = as_right(seen)
    path.mkdir()
    for k in range(FRAMES):
        found = {"hand_pose": torch.as_tensor(fingers[:, k]).numpy(), "global_orient": wrists[:, k],
                 "betas": np.zeros((2, 10)), "is_right": np.array([0.0, 1.0])}  # fmt: skip
        (path / f"frame_{k + 1:04d}.pkl").write_bytes(pickle.dumps(found))


def hamer_info(path, seen):
    """A list with an entry for each frame; None without hands."""
    fingers, wrists = as_right(seen)
    frames = [
        {"all_right": [np.float32(1), np.float32(0)], "all_verts": [np.zeros((778, 3))] * 2,
         "all_pred_mano_params": [
             {"hand_pose": fingers[side, k], "global_orient": wrists[side, k]} for side in (1, 0)
         ]}
        for k in range(FRAMES)
    ]  # fmt: skip
    path.write_bytes(pickle.dumps(frames))


def wilor_mini(path, seen):
    fingers, wrists = (vectors(x) for x in as_right(seen))
    frames = [
        [{"hand_bbox": [0.0, 0.0, 9.0, 9.0], "is_right": float(side),
          "wilor_preds": {"hand_pose": fingers[side, k][None].astype("f4"),
                          "global_orient": wrists[side, k][None].astype("f4")}} for side in (1, 0)]
        for k in range(FRAMES)
    ]  # fmt: skip
    path.write_bytes(pickle.dumps(frames))


def json_by_picture(path, seen):
    fingers, wrists = as_right(seen)
    found = {
        f"frames/{k:05d}.jpg": {
            "hands": [{"hand_type": name, "pred_mano_params": {
                "hand_pose": fingers[side, k].tolist(),
                "global_orient": wrists[side, k].tolist()}}
                for side, name in enumerate(("left", "right"))]}
        for k in range(FRAMES)
    }  # fmt: skip
    path.write_text(json.dumps(found))


def dyn_hamr(path, seen):
    """Arrays of a whole video, of hands as they are."""
    fingers, wrists = (vectors(x) for x in seen)
    right = np.repeat([[0.0], [1.0]], FRAMES, 1)
    np.savez(path, pose_body=fingers, root_orient=wrists[:, :, 0], is_right=right)


@pytest.mark.parametrize(
    ("write", "name"),
    [(hamer_folder, "out"), (hamer_info, "hamer_info.pkl"), (wilor_mini, "hands.pkl"),
     (json_by_picture, "hands.json"), (dyn_hamr, "hands.npz")],
)  # fmt: skip
def test_every_form_gives_the_same_hands(tmp_path, body, seen, write, name):
    write(tmp_path / name, seen)
    found, notes = merge_hands(body, tmp_path / name, np.zeros((30, 3)), wrists=True)
    R = matrices(found.rotations)
    fingers, wrists = seen
    assert np.abs(R[:, LEFT_HAND] - fingers[0]).max() < 1e-5
    assert np.abs(R[:, RIGHT_HAND] - fingers[1]).max() < 1e-5
    for k, side in enumerate(("left", "right")):
        chain = R[:, JOINTS.index(f"{side}_wrist")]
        for joint in reversed(ELBOWS[side]):
            chain = R[:, joint] @ chain
        assert np.abs(chain - wrists[k][:, 0]).max() < 1e-5
    rest = np.ones(55, bool)
    rest[[20, 21, *range(25, 55)]] = False
    assert (found.rotations[:, rest] == body.rotations[:, rest]).all()
    assert f"of {FRAMES} frames, hands of" in notes[-1] and "in 40 left and 40 right" in notes[-1]
    assert ("they are mirrored back" in notes[0]) == (write is not dyn_hamr)


def test_hands_that_are_missing_are_relaxed_or_the_body_s(tmp_path, body, seen):
    """Between frames that lie close they are interpolated; mean hands are added where asked for."""
    fingers = vectors(seen[0])
    frames = [None] * FRAMES
    for k in (2, 5, 30):
        frames[k] = {"is_right": 1, "hand_pose": fingers[1, 0]}
    (tmp_path / "h.pkl").write_bytes(pickle.dumps(frames))
    found, notes = merge_hands(body, tmp_path / "h.pkl", np.zeros((30, 3)))
    right = found.rotations[:, RIGHT_HAND]
    assert np.abs(matrices(right[:10]) - seen[0][1, 0]).max() < 1e-9  # held for 5 frames
    relaxed = found.rotations[:, LEFT_HAND]
    assert (relaxed == relaxed[0]).all() and np.abs(relaxed).max() > 0.1
    assert np.allclose(right[15:20], relaxed[0] * [1, -1, -1])
    steps = np.linalg.norm(np.diff(right, axis=0), axis=-1).max()
    assert steps < 0.3 * np.linalg.norm(right[0] - right[17], axis=-1).max()  # no jump
    assert "in 0 left and 3 right; between them interpolated or relaxed" in notes[-1]
    mean = np.full((30, 3), 0.1)
    found, _ = merge_hands(body, tmp_path / "h.pkl", mean, from_mean=True)
    assert np.allclose(found.rotations[5, RIGHT_HAND], fingers[1, 0] + 0.1)
    own = make_track("body", "0", None, {"poses": np.full((FRAMES, 165), 0.05)}, np.eye(3))
    found, _ = merge_hands(own, tmp_path / "h.pkl", mean)
    assert np.allclose(found.rotations[15:20, LEFT_HAND.start :], 0.05)


def test_of_several_people_s_hands_the_one_at_the_wrist_counts(tmp_path, body, seen):
    joints = TargetBody.read(None).joints
    wrist = pixels_by_frame(body, joints)[0][JOINTS.index("right_wrist")]
    box = lambda x, y: [x - 1, y - 1, x + 1, y + 1]
    hands = [{"is_right": 1, "hand_pose": seen[0][1, k], "bbox": box(*(wrist + 0.3 * (1 - k)))}
             for k in range(2)]  # fmt: skip
    (tmp_path / "h.pkl").write_bytes(pickle.dumps([hands]))
    found, _ = merge_hands(body, tmp_path / "h.pkl", np.zeros((30, 3)), body=joints)
    assert np.abs(matrices(found.rotations[0, RIGHT_HAND]) - seen[0][1, 1]).max() < 1e-9


def test_files_that_are_no_hands_are_described(tmp_path, body, seen):
    for found, words in (
        ([{"betas": np.zeros(10)}], "holds no hands; expected hands of HaMeR or WiLoR"),
        ([{"hand_pose": np.zeros((15, 3))}], "says of no hand which it is"),
        ([{"hand_pose": np.zeros((1, 12)), "is_right": 1}], r"or axis-angle \(45\).*of a PCA are"),
        (
            [{"hand_pose": np.zeros((15, 3)), "is_right": 3}],
            "'is_right' must be 0 or 1 for 1 hands",
        ),
        ([None] * 90 + [{"hand_pose": np.zeros(45), "is_right": 1}], "none of the body's, 0 to 39"),
        (7, "holds no hands"),
    ):
        (tmp_path / "h.pkl").write_bytes(pickle.dumps(found))
        with pytest.raises(InputError, match=words):
            merge_hands(body, tmp_path / "h.pkl", np.zeros((30, 3)))
    (tmp_path / "h.pkl").write_bytes(pickle.dumps([{"hand_pose": np.zeros(45), "is_right": 1}]))
    with pytest.raises(InputError, match=r"holds no wrists \(global_orient\), which are asked for"):
        merge_hands(body, tmp_path / "h.pkl", np.zeros((30, 3)), wrists=True)


def test_prepare_and_motion_take_hands(tmp_path, seen, cli, wham, footage, walk):
    rotations, transl = walk(5)
    source = wham(_0=(rotations, transl + [0, 0, 4.0]))
    hamer_info(tmp_path / "hands.pkl", seen)
    said = cli.works("prepare", "wham", source, tmp_path / "s", *footage,
                          "--hands", tmp_path / "hands.pkl", "--wrists", "hands")  # fmt: skip
    assert "in 5 left and 5 right" in said and "flat" not in said
    found = matrices(load_video(tmp_path / "s").pose.rotations)
    assert np.abs(found[:, RIGHT_HAND] - seen[0][1, :5]).max() < 1e-5
    said = cli.works("motion", source, tmp_path / "m.npz", "--source-fps", 30, "--fps", 30,
                          "--hands", tmp_path / "hands.pkl")  # fmt: skip
    assert "in 5 left and 5 right" in said
    poses = np.load(tmp_path / "m.npz")
    hand = matrices(poses["left_hand_pose"].reshape(5, 15, 3))
    assert np.abs(hand - seen[0][0, :5]).max() < 1e-5
    code, _, err = cli("motion", source, tmp_path / "n.npz", "--hands", "tense")
    assert code and "--hands must be relaxed or flat, or hands found by another program" in err
    code, _, err = cli("prepare", "wham", source, tmp_path / "t", *footage, "--wrists", "hands")
    assert code and "--hands-zero and --wrists need --hands" in err
