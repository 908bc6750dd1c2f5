"""``gva-mi view``: bad input is one sentence before any page is served."""

import json

import pytest

from gva_mi.body.pose import save_poses


@pytest.fixture
def run(known, turning, tmp_path):
    known.save(tmp_path / "run/avatar.npz")
    known.save(tmp_path / "alone/avatar.npz")
    save_poses(tmp_path / "run/poses.npz", *turning(6), stage=2)
    return tmp_path / "run"


BAD = {"no run": (("nowhere",), "nowhere: no such file"),
    "no poses": (("alone/avatar.npz",), "alone: holds no poses.npz"),
    "no subject": (("run", "--subject", "nowhere"), "nowhere: no such folder"),
    "other frames": (("run", "--subject", "SUBJECT", "--poses", "few.npz"), "holds 3 frames, but"),
    "no address": (("run", "--host", "203.0.113.9"), "cannot listen at 203.0.113.9, port 8080"),
    "no port": (("run", "--port", "eighty"), "--port must be a whole number from 0")}  # fmt: skip


def test_bad_input_is_one_sentence(run, subject, turning, tmp_path, monkeypatch, cli):
    monkeypatch.chdir(tmp_path)
    save_poses(tmp_path / "few.npz", *turning(3), stage=2)
    for arguments, sentence in BAD.values():
        code, out, err = cli("view", *(subject if x == "SUBJECT" else x for x in arguments))
        assert code == 2 and sentence in err and err.count("\n") == 1, err
        assert "http" not in out


def test_another_video_than_the_run_s_is_refused(run, subject, cli):
    about = {"frames": "another", "masks": "", "cameras": "", "poses": "", "splits": ""}
    (run / "options.json").write_text(json.dumps({"options": {}, "video": about}))
    err = cli.fails("view", run, "--subject", subject)
    assert "was fitted to another video than" in err and "frames" in err
