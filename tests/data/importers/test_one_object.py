"""A dictionary that ``numpy.savez`` packed into a .npz as one object is read like a .npy of it."""

import numpy as np
import pytest

from gva_mi.data.importers.estimators import VideoInfo, read_estimator
from gva_mi.data.importers.motions import MotionOptions, read_motion
from gva_mi.data.importers.target import TargetBody

SMPL = (-0.0018, -0.2233, 0.0282)  # the pelvis
VIEW = VideoInfo((64, 48), focal=70.0)
KEYS = pytest.mark.parametrize("key", ["arr_0", "poses"])


@KEYS
def test_a_motion(key, tmp_path, walk):
    rotations, transl = walk(9)
    motion = {"poses": rotations.reshape(9, 165), "trans": transl, "fps": 30}
    np.save(tmp_path / "m.npy", motion)
    np.savez(tmp_path / "m.npz", **{key: motion})
    options = MotionOptions(fps=30)
    driven = TargetBody.read(None)
    plain, packed = (read_motion(tmp_path / name, driven, options) for name in ("m.npy", "m.npz"))
    assert packed.notes == plain.notes and "SMPL-X, 9 frames at 30 a second" in packed.notes[0]
    assert (packed.pose.rotations == plain.pose.rotations).all()


@KEYS
def test_an_estimators_people_in_a_file_and_a_file_a_frame(key, tmp_path, seen):
    rotations, transl = seen
    pose = np.concatenate([rotations[:, :22], np.ones((5, 2, 3))], axis=1).reshape(-1, 72)
    person = {"pose": pose, "trans": transl, "frame_ids": np.arange(5), "betas": np.zeros((5, 10))}
    np.savez(tmp_path / "wham.npz", **{key: {0: person}})
    kind, (track,) = read_estimator("auto", tmp_path / "wham.npz", VIEW)
    assert kind == "wham" and np.allclose(track.places, transl + SMPL)
    for k in range(5):
        frame = {"poses": pose[k], "transl": transl[k], "betas": np.zeros(10)}
        (tmp_path / "frames").mkdir(exist_ok=True)
        np.savez(tmp_path / f"frames/{k}.npz", **{key: frame})
    kind, (track,) = read_estimator("auto", tmp_path / "frames", VIEW)
    assert kind == "parameters" and np.allclose(track.places, transl + SMPL)
