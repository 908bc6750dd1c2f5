"""``prepare``: who the subject is, missing frames, the body that it is for, and bad sources."""

import json
import pickle

import numpy as np

from gva_mi.app.steps import body_of
from gva_mi.body.body_file import BUILT_IN_BODY
from gva_mi.body.rotations import to_matrices
from gva_mi.body.smplx import load_body
from gva_mi.subject.fingerprint import require_same_body
from gva_mi.subject.video import load_video

WIDTH, HEIGHT, FRAMES = 64, 48, 5


def test_the_folder_says_what_it_was_made_of_and_stays(wham, tmp_path, cli, seen, footage):
    file = wham(_0=seen)
    said = cli.works("prepare", "auto", file, tmp_path / "s", *footage)
    assert "wham, SMPL, 5 frames of 64x48" in said and "betas of SMPL do not carry over" in said
    about = json.loads((tmp_path / "s/prepare.json").read_text())
    assert about["kind"] == "wham" and about["form"] == "SMPL"
    assert about["body"]["name"] == "built-in" and about["body"]["vertices"] > 1000
    assert "--overwrite" in cli.fails("prepare", "auto", file, tmp_path / "s", *footage)


def test_the_longest_track_is_taken_and_gaps_are_filled(wham, tmp_path, cli, seen, footage):
    rotations, transl = seen
    part = [0, 1, 3]
    file = wham(_0=(rotations[part], transl[part], part), _7=(rotations[:2], transl[:2]))
    said = cli.works("prepare", "wham", file, tmp_path / "s", *footage)
    assert "person 0, seen longest of 0 (3 frames), 7 (2 frames)" in said
    assert "frames without a pose, interpolated: 2" in said and "left out: 4" in said
    video = load_video(tmp_path / "s")
    assert set(video.absent) == {4}
    middle = to_matrices(video.pose.rotations[2, 1:22].numpy())
    assert np.abs(middle - to_matrices(rotations[2, 1:22])).max() < 1e-3
    err = cli.fails("prepare", "wham", file, tmp_path / "b", *footage, "--person", "3")
    assert "has no person '3'; it has 0 (3 frames), 7 (2 frames)" in err
    said = cli.works("prepare", "wham", file, tmp_path / "b", *footage, "--person", "7")
    assert "left out: 2-4" in said


def test_the_masks_choose_the_(wham, tmp_path, cli, seen, footage):
    rotations, transl = seen
    aside = transl + np.array([-1.0, 0.0, 0.0])  # farther left than the masks reach
    file = wham(_0=(rotations, aside), _7=(rotations[:4], transl[:4]))
    mask = np.zeros((FRAMES, HEIGHT, WIDTH), bool)
    mask[:, :, 22:48] = True
    np.save(tmp_path / "masks.npy", mask)
    said = cli.works("prepare", "wham", file, tmp_path / "s", *footage)
    assert "person 7, most inside the masks, of 0 (5 frames, " in said
    assert json.loads((tmp_path / "s/prepare.json").read_text())["person"] == "7"


def test_later_steps_take_the_body_that_was_prepared_for(wham, tmp_path, cli, seen, footage):
    file, subject = wham(_0=seen), tmp_path / "s"
    err = cli.fails("prepare", "wham", file, subject, *footage[2:])
    assert "--body" in err and not subject.exists()
    other = dict(np.load(BUILT_IN_BODY))
    np.savez(tmp_path / "taller.npz", **other | {"v_template": 1.02 * other["v_template"]})
    taller = ["--body", tmp_path / "taller.npz"]
    said = cli.works("prepare", "wham", file, subject, *taller, *footage[2:])
    assert "retargeted to the body taller: rotations and the pelvis's place" in said
    before = sorted(subject.rglob("*"))
    require_same_body(subject, load_body(body_of(subject)))
    err = cli.fails("refine", subject, "--body", "built-in")
    assert err.count("\n") == 1
    assert (
        "its poses belong to another body (" in err
        and "expected --body with that body (taller)" in err
    )
    (tmp_path / "taller.npz").unlink()
    err = cli.fails("refine", subject)
    assert err.count("\n") == 1
    assert f"was prepared for the body {tmp_path}/taller.npz, which does not exist" in err
    assert sorted(subject.rglob("*")) == before


def test_bad_sources_are_refused_in_one_sentence(wham, tmp_path, cli, seen, footage):
    def refused(words, *arguments):
        err = cli.fails("prepare", *arguments)
        assert words in err and err.count("\n") <= 2, err
        assert not (tmp_path / "s").exists()

    file, out = tmp_path / "x.pkl", tmp_path / "s"
    file.write_bytes(pickle.dumps({"a": 1}))
    refused("unknown estimator format, holds a; expected one of wham: people with", "auto", file,
        out, *footage)  # fmt: skip
    refused("not a source of gvhmr, holds a; expected smpl_params", "gvhmr", file, out, *footage)
    refused("kind must be auto, video, wham", "mystery", file, out, *footage)
    file = wham(_0=seen)
    few = [*footage[:4], "--masks", tmp_path / "few.npy"]
    np.save(few[-1], np.ones((2, HEIGHT, WIDTH), bool))
    refused("holds 2 masks, but there are more pictures", "auto", file, out, *few)
    np.save(few[-1], np.ones((FRAMES, 9, WIDTH), bool))
    refused("mask 0 is 64x9, expected 64x48", "auto", file, out, *few)
