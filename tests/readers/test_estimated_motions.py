"""What pose estimators saw, as motions: in their world, or before a camera that stands still."""

import zlib

import numpy as np
import pytest
from samples.data_sets import SMPL
from samples.estimates import dumped, of_smpl
from samples.joblib_files import joblib_dump
from samples.rotations import matrices, same

from gva_mi.body.rotations import to_rotvecs as vectors
from gva_mi.core.errors import InputError
from gva_mi.readers.motions import MotionOptions, read_motion
from gva_mi.readers.target_body import TargetBody


def turned(R, rotations):
    """The same bodies with their roots turned by R (3, 3), or (T, 3, 3)."""
    found = rotations.copy()
    found[:, 0] = vectors(R @ matrices(rotations[:, 0]))
    return found


DOWN = np.diag([1.0, -1.0, -1.0])  # from a world with y up to the axes of a camera
OF_ESTIMATORS = MotionOptions(fps=30, source_fps=30, hands="flat")


def moves_alike(motion, rotations, places, joints=22, tolerance=1e-5):
    """Joints turn as known, and the pelvis goes as ``places`` (T, 3) do, from its own start."""
    assert same(motion.pose.rotations[:, :joints], rotations[:, :joints], tolerance)
    assert np.abs(motion.pose.transl.numpy() - (places - places[0])).max() < tolerance


@pytest.fixture
def before_camera(walk):
    """Somebody upright: rotations and pelvises, in a world with y up and in a camera's axes."""
    rotations, transl = walk(6)
    places = transl + [0.0, 1.0, -4.0]
    return rotations, places, turned(DOWN, rotations), places @ DOWN


def test_wham_in_its_world_from_a_dump_of_joblib(tmp_path, walk):
    rotations, transl = walk(6)
    poses = of_smpl(rotations).reshape(6, 72)
    person = lambda rows: {
        "pose": 0 * poses[rows], "trans": 0 * transl[rows], "betas": np.zeros((len(rows), 10)),
        "pose_world": poses[rows].astype("f4"), "trans_world": transl[rows].astype("f4"),
        "frame_ids": np.array(rows), "verts": np.zeros((len(rows), 9, 3)),
    }  # fmt: skip
    people = {0: person([0, 2]), 7: person([0, 1, 2, 4, 5])}
    for name, pack in (("flat.pkl", bytes), ("packed.pkl", zlib.compress)):
        (tmp_path / name).write_bytes(pack(joblib_dump(people)))
        motion = read_motion(tmp_path / name, TargetBody.read(None), OF_ESTIMATORS)
        moves_alike(motion, rotations, transl, tolerance=1e-3)  # frame 3 is interpolated
        keep = [0, 1, 2, 4, 5]
        assert same(motion.pose.rotations[keep, :22], rotations[keep, :22])
        assert "wham, in the axes of its world" in motion.notes
        assert "frames without numbers, interpolated: 3" in motion.notes
        assert any("person 7, seen longest of 0 (2 frames), 7 (5" in n for n in motion.notes)
        options = MotionOptions(fps=30, source_fps=30, person="0")
        assert len(read_motion(tmp_path / name, TargetBody.read(None), options).pose) == 3


def test_without_a_world_the_camera_stands_still(tmp_path, before_camera):
    rotations, places, seen, pelvis = before_camera
    thetas, transl = of_smpl(seen).reshape(6, 72), pelvis - SMPL
    romp = {
        f"{k}.png": {"smpl_thetas": thetas[k : k + 1], "smpl_betas": np.zeros((1, 10)),
                     "cam_trans": transl[k : k + 1]}
        for k in range(6)
    }  # fmt: skip
    file = dumped(tmp_path / "romp.pkl", {"results": romp})
    motion = read_motion(file, TargetBody.read(None), OF_ESTIMATORS)
    moves_alike(motion, rotations, places)
    assert "-y up" in motion.notes[0]
    assert any("the camera, which is taken to stand still" in n for n in motion.notes)
    with pytest.raises(InputError, match="holds no frame rate.*--source-fps of gva-mi motion"):
        read_motion(file, TargetBody.read(None), MotionOptions())


def test_parameters_a_file_a_frame_are_a_motion(tmp_path, walk):
    rotations, transl = walk(4)
    for k in range(4):
        frame = {"global_orient": rotations[k, :1], "body_pose": rotations[k, 1:22].reshape(1, -1),
                 "transl": transl[k : k + 1], "betas": np.zeros((1, 10))}  # fmt: skip
        dumped(tmp_path / f"out/{k}.pkl", frame)
    options = MotionOptions(fps=30, source_fps=30, hands="flat")
    moves_alike(read_motion(tmp_path / "out", TargetBody.read(None), options), rotations, transl)


def test_places_by_an_assumed_lens_are_refused(tmp_path):
    phalp = dumped(tmp_path / "p.pkl", {"0.jpg": {"tid": [2], "smpl": [], "camera": []}})
    with pytest.raises(InputError, match="written by 4dhumans, whose positions depend on a lens"):
        read_motion(phalp, TargetBody.read(None), OF_ESTIMATORS)


def test_an_unknown_folder_is_described(tmp_path):
    (tmp_path / "x/frames").mkdir(parents=True)
    (tmp_path / "x/poses.npz").write_text("")
    for folder, words in (
        (tmp_path / "x/frames", "frames: holds no motion in a known format; expected a file"),
        (tmp_path / "x", "x: holds no motion.*its motion is .*poses.npz"),
        (tmp_path / "nowhere", "nowhere: no such file; expected a motion such as"),
    ):
        with pytest.raises(InputError, match=words):
            read_motion(folder, TargetBody.read(None), MotionOptions())


def test_frames_that_lie_far_apart_are_refused(tmp_path):
    person = {"pose": np.zeros((2, 72)), "trans": np.zeros((2, 3)), "betas": np.zeros((2, 10)),
              "frame_ids": np.array([0, 10**12])}  # fmt: skip
    with pytest.raises(InputError, match="frames 0 to 1000000000000, expected at most 1,000,000"):
        read_motion(dumped(tmp_path / "w.pkl", {0: person}), TargetBody.read(None), OF_ESTIMATORS)
