"""``gva-mi track`` and ``evaluate --fit-poses``: poses fitted to pictures, only on request."""

import json
import shutil

import pytest
import torch

from gva_mi import app
from gva_mi.avatar.avatar import AvatarOptions
from gva_mi.avatar.canonical import SeedOptions
from gva_mi.body.pose import load_poses, save_poses
from gva_mi.fit import run_folder
from gva_mi.fit.options import FitOptions, Schedule
from gva_mi.fit.photometric import FITTED, PhotometricOptions
from gva_mi.fit.train import fit
from gva_mi.subject.video import load_video


@pytest.fixture
def person(subject, tmp_path):
    """The subject with its true poses, and stage-1 poses that are off by 3 cm."""
    folder = shutil.copytree(subject, tmp_path / "person")
    (folder / "truth").mkdir()
    shutil.copy(folder / "poses.npz", folder / "truth/poses.npz")
    pose, shape = load_poses(folder / "poses.npz")
    pose.transl[:, 0] += 0.03
    save_poses(folder / "poses.npz", pose, shape, stage=1)
    return folder


@pytest.fixture
def avatar(known, tmp_path):
    known.save(tmp_path / "avatar.npz")
    return tmp_path / "avatar.npz"


def test_tracking_moves_poses_to_the_pictures(person, avatar, cli, capsys):
    options = PhotometricOptions(passes=6, step=0.01, translation_lr=0.01)
    (person / "masks/000002.png").unlink()
    app.track(avatar, person, options)
    assert "frame 2 keeps its pose: it has no mask" in capsys.readouterr().out
    found, _ = load_poses(person / "poses_photometric.npz")
    record = json.loads((person / "photometric.json").read_text())
    away = (found.transl - load_poses(person / "truth/poses.npz")[0].transl)[:, 0].abs()
    seen = torch.arange(len(found)) != 2
    assert away[seen].max() < 0.01  # in the image plane; a picture shows little of depth
    assert record["loss"] < record["loss_start"]
    video = load_video(person, person / "poses_photometric.npz")
    assert torch.equal(video.pose.transl, found.transl)
    cli.refuses("--overwrite", "track", avatar, person, "--passes", 6)


def test_trained_poses_of_another_video_are_not_used(person, avatar, cli):
    """Both videos have as many frames, so nothing else would stop it."""
    run = avatar.parent
    shutil.copy(person / "truth/poses.npz", run / "poses.npz")
    first = load_video(person)
    run_folder.prepare(run / "fit", {}, first, resume=False)
    for name in ("avatar.npz", "poses.npz"):
        shutil.copy(run / name, run / "fit")
    assert "another video" not in cli.works("track", run / "fit", person, "--passes", 1)
    record = json.loads((person / "photometric.json").read_text())
    assert record["start"] == str(run / "fit/poses.npz")
    shutil.copy(person / "frames/000001.png", person / "frames/000000.png")
    out = cli.works("track", run / "fit", person, "--passes", 1, "--overwrite")
    assert "was fitted to another video (other frames)" in out
    record = json.loads((person / "photometric.json").read_text())
    assert record["start"] == str(person / "poses.npz")


@pytest.mark.slow
def test_test_frames_are_fitted_only_on_request(video, body, subject, tmp_path, cli):
    options = FitOptions(steps=4, window=16, avatar=AvatarOptions(seed=SeedOptions(count=300)),
        schedule=Schedule(reinit_at=()))  # fmt: skip
    fit(video, body, options, tmp_path)
    rows = {}
    for arguments in ((), ("--fit-poses",)):
        out = cli.works("evaluate", tmp_path, subject, *arguments)
        rows[arguments] = json.loads((tmp_path / "metrics.json").read_text())["figures"]
        assert (
            (FITTED in out) == (FITTED in (tmp_path / "report.html").read_text()) == bool(arguments)
        )
    plain, every = rows.values()
    assert FITTED not in {row["alignment"] for row in plain}
    fitted = [row for row in every if row not in plain]
    assert [row for row in every if row in plain] == plain
    assert {(row["alignment"], row["split"]) for row in fitted} == {(FITTED, "test")}
    seen = json.loads((tmp_path / "metrics.json").read_text())["protocol"]["seen"]
    assert seen["test pictures"] == ["stage 1", FITTED] and seen["test masks"] == [FITTED]
