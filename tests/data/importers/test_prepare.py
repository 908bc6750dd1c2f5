"""``prepare`` with WHAM, GVHMR, 4D-Humans and SMPLer-X: the person stands where they saw it."""

import json
import pickle

import numpy as np
import roma
import torch

from gva_mi.body.built_in import BUILT_IN_BODY
from gva_mi.body.smplx import load_body
from gva_mi.data.fingerprint import require_same_body
from gva_mi.data.video import load_video

WIDTH, HEIGHT, FRAMES = 64, 48, 5
CENTRE = (WIDTH / 2, HEIGHT / 2)


def matrices(rotations):
    return roma.rotvec_to_rotmat(torch.as_tensor(rotations, dtype=torch.float64)).numpy()


def check(folder, seen, pelvis, focal, joints=22):
    """The folder opens, and the pelvis projects to where the estimator's camera sees it."""
    video = load_video(folder)
    rotations, transl = seen
    assert len(video) == FRAMES
    W = np.diag([1.0, -1.0, -1.0])
    found = matrices(video.pose.rotations)
    assert np.abs(found[:, 0] - W @ matrices(rotations)[:, 0]).max() < 1e-5
    assert np.abs(found[:, 1:joints] - matrices(rotations)[:, 1:joints]).max() < 1e-5
    with torch.no_grad():
        body = load_body()
        place = body(video.pose, video.shape).joints[:, 0].double().numpy()
    at = np.array(pelvis) + transl
    wanted = focal * at[:, :2] / at[:, 2:] + CENTRE
    for k in range(FRAMES):
        assert np.abs(video.cameras[k].project(place[k]) - wanted[k]).max() < 1e-3
    return video


SMPL, SMPLX = (-0.0018, -0.2233, 0.0282), (0.0031, -0.3514, 0.0120)


def wham(seen, frames=None, **more):
    rotations, transl = seen
    pose = np.concatenate([rotations[:, :22], np.ones((len(rotations), 2, 3))], axis=1)
    person = {
        "pose": pose.reshape(-1, 72), "trans": transl, "pose_world": pose.reshape(-1, 72),
        "trans_world": transl, "betas": np.zeros((len(pose), 10)),
        "verts": np.zeros((len(pose), 6890, 3), "f4"),
        "frame_ids": np.arange(len(pose)) if frames is None else frames,
    }  # fmt: skip
    return {np.int64(0): person} | more


def test_wham(tmp_path, cli, seen, footage):
    file = tmp_path / "wham_output.pkl"
    file.write_bytes(pickle.dumps(wham(seen)))
    code, said, err = cli("prepare", "auto", file, tmp_path / "subject", *footage)
    assert code == 0, err
    assert "wham, SMPL, 5 frames of 64x48" in said and "betas of SMPL do not carry over" in said
    check(tmp_path / "subject", seen, SMPL, np.hypot(WIDTH, HEIGHT))
    about = json.loads((tmp_path / "subject/prepare.json").read_text())
    assert about["kind"] == "wham" and about["form"] == "SMPL"
    assert about["body"]["name"] == "puppet" and about["body"]["vertices"] > 1000
    code, _, err = cli("prepare", "auto", file, tmp_path / "subject", *footage)
    assert code == 2 and "--overwrite" in err


def test_the_longest_track_is_taken_and_gaps_are_filled(tmp_path, cli, seen, footage):
    rotations, transl = seen
    part = [0, 1, 3]
    people = wham((rotations[part], transl[part]), frames=np.array(part))
    people |= {np.int64(7): wham((rotations[:2], transl[:2]))[np.int64(0)]}
    file = tmp_path / "wham_output.pkl"
    file.write_bytes(pickle.dumps(people))
    code, said, err = cli("prepare", "wham", file, tmp_path / "subject", *footage)
    assert code == 0, err
    assert "person 0, seen longest of 0 (3 frames), 7 (2 frames)" in said
    assert "frames without a pose, interpolated: 2" in said
    assert "left out: 4" in said
    video = load_video(tmp_path / "subject")
    assert set(video.absent) == {4}
    middle = matrices(video.pose.rotations[2, 1:22])
    assert np.abs(middle - matrices(rotations[2, 1:22])).max() < 1e-3
    code, _, err = cli("prepare", "wham", file, tmp_path / "b", *footage, "--person", "3")
    assert code == 2 and "has no person '3'; it has 0 (3 frames), 7 (2 frames)" in err
    code, said, err = cli("prepare", "wham", file, tmp_path / "b", *footage, "--person", "7")
    assert code == 0 and "left out: 2-4" in said, err


def test_the_masks_choose_the_person(tmp_path, cli, seen, footage):
    rotations, transl = seen
    aside = transl + np.array([-1.0, 0.0, 0.0])  # farther left than the masks reach
    people = wham((rotations, aside)) | {np.int64(7): wham((rotations[:4], transl[:4]))[0]}
    file = tmp_path / "wham_output.pkl"
    file.write_bytes(pickle.dumps(people))
    mask = np.zeros((FRAMES, HEIGHT, WIDTH), bool)
    mask[:, :, 22:48] = True
    np.save(tmp_path / "masks.npy", mask)
    code, said, err = cli("prepare", "wham", file, tmp_path / "subject", *footage)
    assert code == 0, err
    assert "person 7, most inside the masks, of 0 (5 frames, " in said
    assert json.loads((tmp_path / "subject/prepare.json").read_text())["person"] == "7"


def test_later_steps_expect_the_body_that_was_prepared_for(tmp_path, cli, seen, footage):
    file, subject = tmp_path / "wham_output.pkl", tmp_path / "subject"
    file.write_bytes(pickle.dumps(wham(seen)))
    code, _, err = cli("prepare", "wham", file, subject, *footage[2:])
    assert code == 2 and "--body" in err and not subject.exists()
    with np.load(BUILT_IN_BODY) as arrays:
        other = {key: arrays[key] for key in arrays.files}
    other["v_template"] = 1.02 * other["v_template"]
    np.savez(tmp_path / "taller.npz", **other)
    taller = ["--body", tmp_path / "taller.npz"]
    code, said, err = cli("prepare", "wham", file, subject, *taller, *footage[2:])
    assert code == 0, err
    assert "retargeted to the body taller: rotations and the pelvis's place" in said
    assert f"the other steps expect --body {tmp_path}/taller.npz" in said
    before = sorted(subject.rglob("*"))
    for command in (("refine", subject), ("fit", subject, "--out", tmp_path / "run")):
        code, _, err = cli(*command)
        assert code == 2 and err.count("\n") == 1
        assert "prepared for another body, taller (" in err and "expected --body with" in err
    require_same_body(subject, load_body(tmp_path / "taller.npz"))
    assert sorted(subject.rglob("*")) == before
    code, said, err = cli("prepare", "wham", file, subject, *footage, "--overwrite")
    assert code == 0 and "retargeted to the body puppet" in said, err
    code, _, err = cli("refine", subject, *taller)
    assert code == 2 and "expected the built-in puppet, that is no --body" in err
    require_same_body(subject, load_body("puppet"))


def test_gvhmr(tmp_path, cli, seen, footage):
    rotations, transl = seen
    tensor = lambda x: torch.as_tensor(x, dtype=torch.float32)
    person = {"global_orient": tensor(rotations[:, 0]), "transl": tensor(transl),
              "body_pose": tensor(rotations[:, 1:22].reshape(FRAMES, 63)),
              "betas": torch.linspace(0, 1, FRAMES)[:, None].repeat(1, 10)}  # fmt: skip
    K = torch.tensor([[70.0, 0, CENTRE[0]], [0, 70, CENTRE[1]], [0, 0, 1]]).repeat(FRAMES, 1, 1)
    found = {"smpl_params_global": person, "smpl_params_incam": person, "K_fullimg": K}
    torch.save(found, tmp_path / "hmr4d_results.pt")
    code, said, err = cli(
        "prepare", "auto", tmp_path / "hmr4d_results.pt", tmp_path / "s", *footage
    )
    assert code == 0, err
    assert "gvhmr, SMPL-X" in said and "betas differ by up to 0.35 from frame to frame" in said
    check(tmp_path / "s", seen, SMPLX, 70)


def test_4d_humans(tmp_path, cli, seen, footage):
    rotations, transl = seen
    R, found = matrices(rotations), {}
    for k in range(FRAMES):
        body = np.concatenate([R[k, 1:22], np.eye(3)[None].repeat(2, 0)])
        smpl = {"global_orient": R[k, :1], "body_pose": body, "betas": np.zeros(10, "f4")}
        found[f"img/{k:06d}.jpg"] = {
            "tid": [2, 9], "tracked_ids": [2], "smpl": [smpl, smpl], "time": k,
            "camera": [transl[k], transl[k]], "size": [[HEIGHT, WIDTH]] * 2, "mask": [],
        }  # fmt: skip
    file = tmp_path / "PHALP.pkl"
    file.write_bytes(pickle.dumps(found))
    code, said, err = cli("prepare", "auto", file, tmp_path / "subject", *footage)
    assert code == 0, err
    assert "4dhumans, SMPL" in said
    check(tmp_path / "subject", seen, SMPL, 5000 / 256 * WIDTH)


def test_smpler_x(tmp_path, cli, seen, footage):
    rotations, transl = seen
    (tmp_path / "run/smplx").mkdir(parents=True)
    (tmp_path / "run/meta").mkdir()
    for k in range(FRAMES):
        name = f"{k + 1:05}_0"
        r = rotations[k]
        np.savez(
            tmp_path / f"run/smplx/{name}.npz", global_orient=r[:1], body_pose=r[1:22],
            left_hand_pose=r[25:40], right_hand_pose=r[40:], jaw_pose=r[22:23],
            leye_pose=np.zeros((1, 3)), reye_pose=np.zeros((1, 3)), betas=np.zeros((1, 10)),
            expression=np.zeros((1, 10)), transl=transl[k : k + 1],
        )  # fmt: skip
        meta = {"focal": [80.0, 80.0], "princpt": list(CENTRE), "bbox": [0, 0, 9, 9]}
        (tmp_path / f"run/meta/{name}.json").write_text(json.dumps(meta))
    code, _, err = cli("prepare", "auto", tmp_path / "run", tmp_path / "s", *footage)
    assert code == 2 and "has frame 5, but the video has frames 0 to 4; --first" in err
    assert not (tmp_path / "s").exists()
    code, _, err = cli("prepare", "auto", tmp_path / "run", tmp_path / "s", *footage, "--first", 1)
    assert code == 0, err
    video = check(tmp_path / "s", seen, SMPLX, 80)
    with np.load(BUILT_IN_BODY) as body:
        mean = np.concatenate([body["hands_meanl"], body["hands_meanr"]]).reshape(30, 3)
    assert np.abs(mean).max() > 0.1
    fingers = matrices(rotations[:, 25:] + mean)
    assert np.abs(matrices(video.pose.rotations[:, 25:]) - fingers).max() < 1e-5


def test_bad_sources_are_refused_in_one_sentence(tmp_path, cli, seen, footage):
    def refused(words, *arguments):
        code, _, err = cli("prepare", *arguments)
        assert code == 2 and words in err and err.count("\n") <= 2, err
        assert not (tmp_path / "s").exists()

    file, out = tmp_path / "x.pkl", tmp_path / "s"
    file.write_bytes(pickle.dumps({"a": 1}))
    refused("of no kind that is known; looked for wham: people with", "auto", file, out, *footage)
    refused("not of the kind gvhmr; expected smpl_params_incam", "gvhmr", file, out, *footage)
    refused("kind must be auto, wham", "mystery", file, out, *footage)
    file.write_bytes(pickle.dumps(wham(seen)))
    np.save(tmp_path / "few.npy", np.ones((2, HEIGHT, WIDTH), bool))
    few = [*footage[:4], "--masks", tmp_path / "few.npy"]
    refused("holds 2 masks, but there are more pictures", "auto", file, out, *few)
    np.save(tmp_path / "few.npy", np.ones((FRAMES, 9, WIDTH), bool))
    refused("mask 0 is 64x9, expected 64x48", "auto", file, out, *few)
