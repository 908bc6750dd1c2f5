"""Motions in every form give the same poses."""

import io
import pickle
import re
from contextlib import redirect_stdout

import numpy as np
import pytest
import roma
import torch
from samples.rotations import matrices, same

from gva_mi.app.driving import motion_of
from gva_mi.body.pose import Shape, load_poses
from gva_mi.body.rotations import to_rotvecs as vectors
from gva_mi.core.errors import InputError
from gva_mi.readers.motions import MotionOptions, read_motion
from gva_mi.readers.target_body import TargetBody
from gva_mi.subject.silhouettes import joints_in_world
from gva_mi.synthetic.motion.motions import perform

SAME_RATE = MotionOptions(fps=30, hands="flat")
SMPL = [*range(22)]
SMPLH = [*range(22), *range(25, 55)]


@pytest.fixture
def read(tmp_path):
    def save_and_read(options=SAME_RATE, pickled=False, **arrays):
        path = tmp_path / ("motion.pkl" if pickled else "motion.npz")
        if pickled:
            path.write_bytes(pickle.dumps(arrays, protocol=2))
        else:
            np.savez(path, **arrays)
        return read_motion(path, TargetBody.read(None), options)

    return save_and_read


def test_amass_in_every_width(read, walk):
    rotations, transl = walk(9)
    whole = read(poses=rotations.reshape(9, 165), trans=transl, betas=np.ones(16),
                 mocap_frame_rate=np.array(30), gender=np.array("neutral"))  # fmt: skip
    assert same(whole.pose.rotations, rotations) and np.allclose(whole.pose.transl, transl)
    assert whole.shape.betas.tolist() == [1] * 16
    assert "SMPL-X, 9 frames at 30 a second, y up; now 9 at 30" in whole.notes[0]
    cut = read(poses=rotations, trans=transl, mocap_frame_rate=30.0, gender=b"male")
    assert same(cut.pose.rotations, rotations) and not cut.shape.betas.any()
    old = read(poses=rotations[:, SMPLH].reshape(9, 156), trans=transl, betas=np.ones(16),
               mocap_framerate=30.00001, gender=np.array(b"female"), dmpls=np.zeros((9, 8)),
               markers=np.full((9, 41, 3), np.nan))  # fmt: skip
    assert same(old.pose.rotations[:, SMPLH], rotations[:, SMPLH])
    assert not old.pose.rotations[:, 22:25].any() and not old.shape.betas.any()
    smpl = np.concatenate([rotations[:, SMPL], np.ones((9, 2, 3))], axis=1).reshape(9, 72)
    small = read(poses=smpl, trans=transl, fps=30)
    assert same(small.pose.rotations[:, SMPL], rotations[:, SMPL])
    assert not small.pose.rotations[:, 22:].any(), "mittens bend no finger"
    assert "the source has no hands; they are flat" in small.notes


def test_amass_in_parts(read, walk):
    rotations, transl = walk(5)
    flat = lambda part: rotations[:, part].reshape(5, -1)
    parts = {"root_orient": flat(slice(0, 1)), "pose_body": flat(slice(1, 22)),
        "pose_jaw": flat(slice(22, 23)), "pose_eye": flat(slice(23, 25)),
        "pose_hand": flat(slice(25, 55)), "trans": transl, "mocap_frame_rate": 30}  # fmt: skip
    assert same(read(**parts).pose.rotations, rotations)


def test_aist_counts_in_centimetres_at_60_frames_a_second(read, walk):
    rotations, transl = walk(7)
    found = read(MotionOptions(fps=60), pickled=True, smpl_poses=rotations[:, :24].reshape(7, 72),
        smpl_trans=transl * 98.0, smpl_scaling=np.array([98.0]), smpl_loss=0.1)  # fmt: skip
    assert np.allclose(found.pose.transl, transl - transl[0], atol=1e-6)
    assert "7 frames at 60 a second" in found.notes[0]
    assert "the source has no hands; they are relaxed" in found.notes
    assert found.pose.rotations[:, 25:].abs().max() > 0.1


TURNS = {"z": (np.pi / 2, 0, 0), "-y": (np.pi, 0, 0), "-z": (-np.pi / 2, 0, 0),
         "x": (0, 0, -np.pi / 2), "-x": (0, 0, np.pi / 2)}  # fmt: skip


@pytest.mark.parametrize("up", TURNS)
def test_any_axis_may_be_up(read, walk, body, up):
    """The same walk in another world comes back to where each joint was."""
    rotations, transl = walk(6)
    joints = body.rest(Shape(torch.zeros(10))).joints.double().numpy()
    before = joints_in_world(rotations, transl, joints)
    W = matrices(np.array(TURNS[up]))
    turned = rotations.copy()
    turned[:, 0] = vectors(W @ matrices(rotations[:, 0]))
    moved = (joints[0] + transl) @ W.T - joints[0]
    found = read(poses=turned.reshape(6, -1), trans=moved, mocap_frame_rate=30)
    assert f"{up} up" in found.notes[0]
    after = joints_in_world(found.pose.rotations.numpy(), found.pose.transl.numpy(), joints)
    assert np.abs(after - before).max() < 1e-5


def test_a_lying_person_needs_an_up_axis(read, walk):
    rotations, transl = walk(3)
    rotations[:, 0] = (0.6755, 0, -0.6755)  # upward is now the diagonal of the axes
    with pytest.raises(InputError, match="above the feet along no axis; give --up"):
        read(poses=rotations, trans=transl, fps=30)
    read(MotionOptions(fps=30, up="y"), poses=rotations, trans=transl, fps=30)


def test_another_frame_rate(read, walk):
    rotations, transl = walk(121)
    found = read(MotionOptions(fps=25), poses=rotations, trans=transl, mocap_framerate=120.00004)
    assert len(found.pose) == 26 and "121 frames at 120 a second" in found.notes[0]
    assert same(found.pose.rotations[5], rotations[24]), "0.2 s"
    half = read(MotionOptions(fps=240), poses=rotations, trans=transl, fps=120).pose
    ends = (torch.as_tensor(rotations[k]) for k in (3, 4))
    wanted = roma.rotvec_slerp(*ends, torch.tensor([0.5], dtype=torch.float64))[0]
    assert same(half.rotations[7], wanted, 1e-5)
    assert np.allclose(half.transl[7], (transl[3] + transl[4]) / 2 - transl[0], atol=1e-6)


def test_short_gaps_are_filled_and_listed(read, walk):
    rotations, transl = walk(40)
    holes = rotations.copy()
    holes[[3, 10, 11]] = np.nan
    found = read(poses=holes, trans=transl, fps=30)
    assert "frames without numbers, interpolated: 3, 10-11" in found.notes
    assert np.abs(matrices(found.pose.rotations) - matrices(rotations)).max() < 5e-3
    holes[2:39] = np.nan
    with pytest.raises(InputError, match="1.23 s in a row without numbers, in frames 2-38;"):
        read(poses=holes, trans=transl, fps=30)
    with pytest.raises(InputError, match="every frame holds a number that is not finite"):
        read(poses=holes * np.nan, trans=transl, fps=30)


def test_varying_betas_become_their_median(read, walk):
    rotations, transl = walk(7)
    betas = np.tile(np.linspace(0, 1, 10), (7, 1))
    betas[:, 0] += np.array([0, 0, 0, 0, 9, 0, 0])  # one frame that the estimator got wrong
    found = read(poses=rotations, trans=transl, betas=betas, fps=30)
    assert np.allclose(found.shape.betas, np.linspace(0, 1, 10))
    assert any("betas differ by up to 3.1 from frame to frame; their" in n for n in found.notes)


POSES = {"poses": np.zeros((2, 72)), "fps": 30}
BAD = {
    "no poses": ({"a": np.ones(3), "fps": 30}, "holds no poses of one person;.*found: a"),
    "no rate": ({"poses": np.zeros((2, 72))}, "holds no frame rate.*give --source-fps"),
    "a time in the place of a rate": (
        POSES | {"mocap_framerate": 1 / 30},
        "'mocap_framerate' must be frames a second, got 0.0333.*; seconds between frames\\? "
        "--source-fps 30",
    ),
    "times of all frames": (POSES | {"fps": np.arange(2) / 30}, "'fps' must be frames a second"),
    "a rate of 0": (POSES | {"fps": 0}, "'fps' must be frames a second, got 0"),
    "no scaling": (
        POSES | {"smpl_trans": np.zeros((2, 3)), "smpl_scaling": 0},
        "'smpl_scaling' must be one number above 0",
    ),
    "a width of no body": (POSES | {"poses": np.zeros((2, 75))}, "'poses' has 75 numbers"),
    "no frame": (POSES | {"poses": np.zeros((0, 72))}, "'poses' has 0 numbers a frame"),
    "other count": (
        POSES | {"trans": np.zeros((3, 3))}, r"'trans' must be \(2, 3\), got \(3, 3\)",
    ),
    "components of a PCA": (
        {"global_orient": np.zeros((2, 3)), "body_pose": np.zeros((2, 63)),
         "left_hand_pose": np.zeros((2, 12))},
        r"'left_hand_pose' must be \(2, 45\), axis-angle and no components of a PCA",
    ),
    "no rotations": (
        {"global_orient": np.zeros((1, 3)), "body_pose": np.zeros((1, 21, 3, 3))},
        "must hold rotation matrices",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_a_bad_motion_is_refused_in_one_sentence(read, case):
    arrays, words = BAD[case]
    with pytest.raises(InputError, match=words) as caught:
        read(**arrays)
    assert "motion.npz" in str(caught.value)


def test_the_command_writes_poses_that_render_takes(tmp_path, cli, walk, known, camera):
    from gva_mi.subject.cameras import save_cameras

    rotations, transl = walk(3)
    np.savez(tmp_path / "amass.npz", poses=rotations, trans=transl, mocap_frame_rate=30)
    out = tmp_path / "poses.npz"
    said = cli.works("motion", tmp_path / "amass.npz", out, "--fps", 30)
    assert "y up" in said and f"3 poses: {out}" in said
    assert same(load_poses(out)[0].rotations, rotations)
    assert "exists already" in cli.fails("motion", tmp_path / "amass.npz", out)
    cli.refuses("--fps must be a number from 0.001", "motion", tmp_path / "amass.npz",
        tmp_path / "b.npz", "--fps", 0)  # fmt: skip
    known.save(tmp_path / "avatar.npz")
    save_cameras(tmp_path / "cameras.npz", [camera])
    cli.works("render", tmp_path / "avatar.npz", "--poses", out, "--cameras",
                       tmp_path / "cameras.npz", "--out", tmp_path / "renders")  # fmt: skip
    assert len(list((tmp_path / "renders").glob("*.png"))) == 3


@pytest.mark.parametrize("name", ["walk", "dance", "still"])
def test_a_quiet_motion_in_centimetres_is_doubted(name, read, body):
    """A foot of a walking person stays. In centimetres both feet go as far as the pelvis."""
    joints = body.rest(Shape(torch.zeros(10))).joints.double().numpy()
    pose = perform(name, np.arange(90) / 180, joints, 10, np.random.default_rng(0))
    rotations, transl = pose.rotations.double().numpy(), pose.transl.double().numpy()
    for scale in (1, 100, 1000):
        notes = read(poses=rotations, trans=scale * transl, fps=30).notes
        doubts = [note for note in notes if "m in a second without a step: in centimetres" in note]
        assert len(doubts) == (scale > 1), notes
    speed = 30 * np.linalg.norm(np.diff(transl, axis=0), axis=1).mean()
    assert speed < 2  # as quiet as a walk


def test_a_file_without_a_rate_is_played_pose_by_pose(tmp_path, walk, known):
    """render, export and view have no --source-fps: one pose is one frame, as of own poses."""
    rotations, transl = walk(7)
    np.savez(tmp_path / "m.npz", poses=rotations, trans=transl)
    said = io.StringIO()
    with redirect_stdout(said):
        pose, _ = motion_of(tmp_path, known, tmp_path / "m.npz", 24, None)
    assert same(pose.rotations, rotations) and np.allclose(pose.transl, transl, atol=1e-6)
    assert "no frame rate is known: each pose is one frame" in said.getvalue()


LIE = np.array([-np.pi / 2, 0, 0])  # with y up


def test_the_up_axis_is_that_of_the_floor_and_the_first_frames(read, walk, body):
    """Not of most frames: who lies down, or stands on the hands, begins upright."""
    _, transl = walk(90)
    joints = body.rest(Shape(torch.zeros(10))).joints.double().numpy()
    share = np.clip((np.arange(90) - 20) / 10, 0, 1)[:, None]
    for end in (LIE, 2 * LIE):  # on the back, head down
        rotations = np.zeros((90, 55, 3))
        rotations[:, 0] = share * end
        down = joints_in_world(rotations, 0 * rotations[:, 0], joints)[..., 1].min(1)
        moved = transl * [1, 0, 1] - np.outer(down, [0, 1, 0])  # on the floor
        for up in ("y", "z"):
            W = np.eye(3) if up == "y" else matrices(np.array(TURNS["z"]))
            turned = rotations.copy()
            turned[:, 0] = vectors(W @ matrices(rotations[:, 0]))
            found = read(poses=turned, trans=moved @ W.T, fps=30)
            assert f"{up} up" in found.notes[0] and not any("leans" in n for n in found.notes)


@pytest.mark.parametrize("degrees", [15, 37])
def test_a_tilted_world_is_said_from_20_degrees_on(read, walk, degrees):
    rotations, transl = walk(9)
    rotations[:, 0] = [np.radians(degrees), 0, 0]
    rotations[:, 1:] = 0
    found = read(poses=rotations, trans=transl, fps=30)
    assert "y up" in found.notes[0]
    said = [note for note in found.notes if "leans" in note]
    assert len(said) == (degrees > 20)
    assert all(re.search("leans 3[678] degrees from that axis; --up takes", x) for x in said)
