"""``--poses`` of render, export and view: any motion that ``gva-mi motion`` reads."""

import pickle

import numpy as np
import pytest
import torch

from gva_mi.body.pose import save_poses
from gva_mi.splat.axes import half_turned
from gva_mi.splat.formats.ply import load_ply

SMALL = ("--size", 32, 48)


@pytest.fixture
def motions(turning, tmp_path):
    """One motion of six frames in two other forms, at 30 a second, and its poses."""
    pose, _ = turning(6)
    rotations, transl = pose.rotations.numpy(), pose.transl.numpy()
    smpl = np.concatenate([rotations[:, :22], np.zeros((6, 2, 3))], axis=1).reshape(6, 72)
    np.savez(tmp_path / "amass.npz", poses=rotations, trans=transl, mocap_frame_rate=30,
             betas=np.zeros(10))  # fmt: skip
    aist = {"smpl_poses": smpl, "smpl_trans": 90 * transl, "smpl_scaling": 90.0, "fps": 30}
    (tmp_path / "aist.pkl").write_bytes(pickle.dumps(aist))
    return pose


def test_a_motion_of_another_program_drives_unchanged(run, motions, known, cli):
    path, out = run.parent / "amass.npz", run / "a.ply"
    said = cli.works("export", run, "--poses", path, "--frame", 4, "--out", out)
    assert f"{path}: SMPL" in said and "6 frames at 30 a second, y up; now 6 at 30" in said
    pose = motions[4]
    pose.transl[:] -= motions.transl[0]
    with torch.no_grad():
        assert torch.allclose(
            load_ply(out).means, half_turned(known(pose)).means, rtol=1e-4, atol=1e-5
        )


def test_each_command_resamples_it_to_its_own_rate(run, motions, cli, monkeypatch):
    path, out = run.parent / "aist.pkl", run.parent / "out"
    said = cli.works("render", run, "--poses", path, "--out", out, *SMALL)
    assert "now 5 at 25, y up" in said and len(list(out.glob("*.png"))) == 5

    out = run.parent / "amass60.npz"
    motion = ("--poses", run.parent / "amass.npz", "--fps", 60, "--out", out)
    assert "6 frames at 30 a second, y up; now 11 at 60" in cli.works("export", run, *motion)
    with np.load(out) as file:
        assert len(file["poses"]) == 11 and float(file["mocap_frame_rate"]) == 60

    def stopped(server):
        raise KeyboardInterrupt

    monkeypatch.setattr("gva_mi.cli.view.pages", stopped)
    said = cli.works("view", run, "--poses", path, "--port", 0)
    assert "6 frames at 30 a second, y up; now 6 at 30" in said and "open it in a browser" in said


def test_own_poses_are_neither_turned_nor_resampled(run, turning, cli):
    pose, shape = turning(6)
    pose.rotations[:, 0, 0] += np.pi  # a headstand
    save_poses(run.parent / "own.npz", pose, shape, stage=1)
    with np.load(run.parent / "own.npz") as file:
        named = {k: x for k, x in file.items() if k != "stage"}
    np.savez(run.parent / "named.npz", **named, fps=120.0)
    for name in ("own.npz", "named.npz"):
        out = run.parent / f"amass_{name}"
        said = cli.works("export", run, "--poses", run.parent / name, "--out", out)
        assert "a second" not in said
        with np.load(out) as file:
            assert len(file["poses"]) == 6


BAD = (({"poses": np.zeros((3, 71)), "fps": 30}, "71"),
    ({"a": np.zeros(3), "fps": 30}, "holds no poses of one person; expected one of poses, pose"),
    ({"mhr_model_params": np.zeros((3, 204))}, "found: mhr_model_params"))  # fmt: skip


def test_an_unreadable_motion_is_one_sentence(run, cli):
    path, out = run.parent / "bad.npz", run.parent / "new"
    for (arrays, words), command in zip(BAD, ("render", "export", "view"), strict=True):
        np.savez(path, **arrays)
        given = {"render": ("--out", out), "export": ("--out", out / "a.ply"), "view": ()}
        err = cli.fails(command, run, "--poses", path, *given[command])
        assert words in err and str(path) in err and err.count("\n") == 1, err
        assert not out.exists()


def test_a_folder_is_no_motion_and_no_video_fits_another_program_s(run, motions, subject, cli):
    err = cli.fails("render", run, "--poses", run, "--out", run.parent / "out")
    assert f"its motion is {run / 'poses.npz'}" in err
    given = ("--poses", run.parent / "amass.npz", "--subject", subject)
    assert "does not belong to a video; expected poses of" in cli.fails("view", run, *given)
