"""Motions of joints alone: HumanML3D's places and features, and what networks make like them."""

import numpy as np
import pytest
from samples.rotations import matrices

from gva_mi.body.pose import JOINTS
from gva_mi.core.errors import InputError
from gva_mi.readers.motions import MotionOptions, read_motion
from gva_mi.readers.target_body import TargetBody
from gva_mi.subject.silhouettes import joints_in_world

BODY = TargetBody.read(None)
AS_IT_IS = MotionOptions(fps=20, hands="flat")
FRAMES = 30


@pytest.fixture(scope="module")
def known():
    """Rotations of a person who turns, bends and gestures, and the joints' places (T, 22, 3)."""
    t = np.arange(FRAMES)[:, None] / 20
    rotations = np.zeros((FRAMES, 55, 3))
    put = lambda name, *xyz: np.copyto(rotations[:, JOINTS.index(name)], np.hstack(
        [np.broadcast_to(x, (FRAMES, 1)) for x in xyz]))  # fmt: skip
    put("pelvis", 0, 0.8 * t, 0)
    for name in ("spine1", "spine2", "spine3"):
        put(name, 0.15 + 0.05 * np.sin(3 * t), 0.1 * np.sin(2 * t), 0.05)
    put("left_shoulder", 0.5 + 0.2 * np.sin(4 * t), -0.4, -0.9)
    put("right_shoulder", -0.3, 0.6 + 0.3 * np.sin(3 * t), 0.7)
    put("left_elbow", 0, -1.1 + 0.2 * np.sin(5 * t), 0)  # elbows and knees are hinges
    put("right_elbow", 0, 1.3, 0)
    put("left_hip", -0.8, 0.3, 0.2 + 0.1 * np.sin(4 * t))
    put("right_hip", -0.6 + 0.2 * np.sin(4 * t), -0.2, -0.1)
    put("left_knee", 1.0, 0, 0)
    put("right_knee", 0.9 + 0.2 * np.sin(4 * t), 0, 0)
    transl = np.hstack([0.4 * t, 1.0 + 0 * t, 0.7 * t])
    return rotations, joints_in_world(rotations, transl, BODY.joints)[:, :22]


def read(path, array, options=AS_IT_IS):
    np.save(path, array)
    return read_motion(path, BODY, options)


def posed(motion):
    transl = motion.pose.transl.double().numpy()
    return joints_in_world(motion.pose.rotations.double().numpy(), transl, BODY.joints)[:, :22]


def of_pelvis(places):
    return places - places[:, :1]


def test_joints_become_poses(tmp_path, known):
    """The joints come back; so do twists that a bent elbow or knee shows."""
    rotations, places = known
    motion = read(tmp_path / "a.npy", places)
    assert np.abs(of_pelvis(posed(motion)) - of_pelvis(places)).max() < 2e-3
    moved = places[:, 0] - places[:1, 0]
    assert np.abs(motion.pose.transl.numpy() - moved).max() < 1e-4
    turned = matrices(motion.pose.rotations).swapaxes(-1, -2) @ matrices(rotations)
    apart = np.degrees(np.arccos(((np.trace(turned, axis1=2, axis2=3) - 1) / 2).clip(-1, 1)))
    for name in ("pelvis", "spine3", "left_knee", "right_knee", "left_elbow", "right_elbow"):
        assert apart[:, JOINTS.index(name)].max() < 6, name
    for name in ("left_shoulder", "right_shoulder", "left_hip", "right_hip"):
        assert apart[:, JOINTS.index(name)].max() < 8, name
    assert "joints without rotations, 30 frames at 20 a second, y up" in motion.notes[0]
    assert "scaled by 1, so" in motion.notes[2] and "no hands; they are flat" in motion.notes[3]


def test_a_taller_person_is_scaled_and_lost_frames_are_interpolated(tmp_path, known):
    _, places = known
    lost = 1.2 * places
    lost[7] = np.nan
    motion = read(tmp_path / "a.npy", lost[None].astype("f4"))
    good = [k for k in range(FRAMES) if k != 7]
    assert np.abs(of_pelvis(posed(motion))[good] - of_pelvis(places)[good]).max() < 2e-3
    assert "frames without numbers, interpolated: 7" in motion.notes


def features_of(places, heading):
    """HumanML3D's features by its definition, with any headings (T,) of the root, radians."""
    T = len(places)
    R = matrices(np.stack([0 * heading, -heading, 0 * heading], 1))  # from the world to the root
    local = places - places[:, :1] * [1, 0, 1]
    local = np.einsum("tab,tjb->tja", R, local)
    step = np.diff(places[:, 0], axis=0, append=places[-1:, 0])
    # The step to the next frame is in that frame's axes.
    step = np.einsum("tab,tb->ta", np.concatenate([R[1:], R[-1:]]), step)
    features = np.zeros((T, 263))
    features[:, 0] = -np.diff(heading, append=heading[-1]) / 2
    features[:, 1], features[:, 2], features[:, 3] = step[:, 0], step[:, 2], places[:, 0, 1]
    features[:, 4:67] = local[:, 1:].reshape(T, 63)
    return features


def test_features_hold_the_same_motion(tmp_path, known):
    _, places = known
    heading = 0.8 * np.arange(FRAMES) / 20 + 0.1 * np.sin(np.arange(FRAMES))
    heading -= heading[0]
    wanted = posed(read(tmp_path / "a.npy", places))
    found = posed(read(tmp_path / "b.npy", features_of(places, heading)[None].astype("f4")))
    assert np.abs(found - wanted).max() < 1e-4
    features = features_of(places, heading)
    with pytest.raises(InputError, match="features by its Std.npy and add its Mean.npy"):
        read(tmp_path / "c.npy", (features - features.mean(0)) / (features.std(0) + 1e-3))


def test_results_of_mdm_hold_several_motions(tmp_path, known):
    _, places = known
    motions = np.stack([places[::-1], places]).transpose(0, 2, 3, 1)
    results = {"motion": motions, "lengths": np.array([30, 20]), "text": ["a", "b"]}
    second = read(tmp_path / "r.npy", results, MotionOptions(fps=20, hands="flat", person="1"))
    assert np.abs(of_pelvis(posed(second)) - of_pelvis(places)[:20]).max() < 2e-3
    with pytest.raises(InputError, match="has no motion 'b'; --person is one of 0 to 1"):
        read(tmp_path / "r.npy", results, MotionOptions(person="b"))


def test_rotations_of_somebody_who_stands_still_are_no_joints(tmp_path, known):
    """Arrays of the same shape (T, 55, 3); and one frame of joints is a motion, too."""
    rotations, places = known
    still = np.tile(rotations[:1], (4, 1, 1)) + 0.05
    options = MotionOptions(fps=20, source_fps=20, hands="flat")
    motion = read(tmp_path / "a.npy", still, options)
    assert np.abs(matrices(motion.pose.rotations) - matrices(still)).max() < 1e-5
    assert len(read(tmp_path / "b.npy", places[:1]).pose) == 1
