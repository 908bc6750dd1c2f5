"""``gva-mi avatar``, ``prepare video`` and ``motion`` of a video, by the real networks."""

import json
import shutil

import numpy as np
import pytest
from samples.web_pages import unpack

from gva_mi.body.body_file import BUILT_IN_BODY, SMPL, read_body
from gva_mi.body.pose import JOINTS, PARENTS, load_poses
from gva_mi.body.smplx import load_body
from gva_mi.networks.segment_anything import MaskGuess, SegmentAnything
from gva_mi.readers.keypoints import LAYOUTS
from gva_mi.subject.ground_truth import truth_of
from gva_mi.subject.landmarks import Landmarks
from gva_mi.subject.pictures import read_image
from gva_mi.subject.video import load_video
from gva_mi.subject.video_file import write_video

FRAMES = 12


@pytest.mark.slow
def test_a_video_becomes_an_avatar_once(filmed, tmp_path, cli):
    """All steps, then none of them; and the same video twice is the same folder, to the bit."""
    recording, height = filmed
    command = ("avatar", recording, "--height", height, "--quality", "draft", "--steps", 40)
    command += ("--out", tmp_path / "me")
    cli.works(*command)
    me = tmp_path / "me"
    assert all((me / name).stat().st_size > 1000 for name in ("turntable.mp4", "walk.mp4"))
    found = json.loads((me / "subject/video_check.json").read_text())
    assert "short video" in {finding["what"] for finding in found["findings"]}
    page = (me / "report.html").read_text()
    assert "How to film better" in page and f"given as {height:.2f} m" in page
    assert 'href="avatar.html"' in page
    played = [motion["name"] for motion in unpack(me / "avatar.html")["motions"]]
    assert played == ["walk", "dance", "the video"]
    rows = json.loads((me / "run/metrics.json").read_text())["figures"]
    whole = {
        (row["alignment"], row["split"]): row["value"]
        for row in rows
        if (row["region"], row["metric"]) == ("white", "PSNR, dB")
    }
    assert whole.keys() == {("", "test")} and whole["", "test"] > 15  # a draft measures no more

    said = cli.works(*command)
    assert said.count("was finished before") == 7
    (me / "report.html").unlink()
    shutil.rmtree(me / "run")
    said = cli.works(*command, "--steps", 20, "--no-test-frames")
    assert said.count("was finished before") == 3
    rows = json.loads((me / "run/metrics.json").read_text())["figures"]
    assert {row["split"] for row in rows if row["metric"] == "SSIM"} == {"train"}

    again = tmp_path / "again"
    assert cli("prepare", "video", recording, again, "--height", height)[0] == 0
    for path in sorted(again.rglob("*.*")):
        if path.name != "splits.json":  # without test frames by now
            there = me / "subject" / path.relative_to(again)
            assert path.read_bytes() == there.read_bytes(), path


@pytest.mark.slow
def test_any_body_becomes_an_avatar(filmed, tmp_path, cli):
    """A body in SMPL's format: no jaw, no eyes, no fingers, no expression, and no correctives."""
    recording, height = filmed
    whole, kept = read_body(BUILT_IN_BODY), list(SMPL.joints)
    weights = np.zeros((len(whole["v_template"]), len(kept)))
    for joint, moved in enumerate(whole["weights"].T):
        while joint not in kept:
            joint = PARENTS[joint]
        weights[:, kept.index(joint)] += moved
    arrays = {name: whole[name] for name in ("v_template", "f")} | {
        "shapedirs": whole["shapedirs"][..., : int(whole["num_betas"])],
        "posedirs": np.zeros((len(weights), 3, 9 * 23)),
        "J_regressor": whole["J_regressor"][kept],
        "weights": weights,
        "kintree_table": np.array([SMPL.parents, range(24)]) % 2**32,
    }
    np.savez(tmp_path / "smpl.npz", **arrays)
    command = ("avatar", recording, "--height", height, "--quality", "draft", "--steps", 10)
    cli.works(*command, "--body", tmp_path / "smpl.npz", "--out", tmp_path / "me")
    for name in ("poses", "poses_refined"):
        pose, shape = load_poses(tmp_path / f"me/subject/{name}.npz")
        for values in (pose.rotations, pose.transl, pose.expression, shape.betas):
            assert values.isfinite().all(), name
    for name, values in np.load(tmp_path / "me/run/avatar.npz").items():
        assert values.dtype.kind != "f" or np.isfinite(values).all(), name
    assert (tmp_path / "me/walk.mp4").stat().st_size > 1000


@pytest.mark.slow
def test_a_video_drives_an_avatar(filmed, tmp_path, cli):
    recording, height = filmed
    cli.works("motion", recording, tmp_path / "m.npz", "--height", height, "--fps", 20)
    pose, _ = load_poses(tmp_path / "m.npz")
    assert 2 * FRAMES - 3 <= len(pose) <= 2 * FRAMES
    assert np.abs(pose.transl[0].numpy()).max() < 1e-5  # at rest's place


@pytest.mark.slow
def test_own_keypoints_take_the_network_s_place(filmed, tmp_path, cli):
    """Joints that are known, as COCO's keypoints."""
    recording, height = filmed
    video, body = load_video(recording.parent), load_body()
    truth = truth_of(video, body)
    known = truth.body(truth.pose, truth.shape).joints.double().numpy()
    names = [name for name in LAYOUTS[17] if name in JOINTS]
    where = lambda joints, k: video.cameras[k].project(joints[k, [JOINTS.index(n) for n in names]])
    people = []
    for k in range(FRAMES):
        at = dict(zip(names, where(known, k) - 0.5, strict=True))
        rows = [[*at[name], 0.9] if name in at else [0, 0, 0] for name in LAYOUTS[17]]
        people.append({"image_id": f"{k}.jpg", "keypoints": np.ravel(rows).tolist()})
    (tmp_path / "k.json").write_text(json.dumps(people))
    given = ("prepare", "video", recording, tmp_path / "s", "--height", height)
    said = cli.works(*given, "--keypoints", tmp_path / "k.json")
    assert f"in {FRAMES} of {FRAMES} frames" in said
    found = Landmarks.load(tmp_path / "s/landmarks.npz")
    for k in range(FRAMES):
        assert np.abs(found.pixels[k, found.indices(names)] - where(known, k)).max() < 1e-3


@pytest.mark.slow
def test_own_masks_take_the_place_of_those_found(filmed, tmp_path, cli):
    """A subject's masks are written as they are given, for every second picture of the video."""
    recording, height = filmed
    given = ("prepare", "video", recording, tmp_path / "s", "--height", height, "--fps", 5)
    own = recording.parent / "masks"
    assert f"masks of {own}" in cli.works(*given, "--masks", own)
    found = sorted((tmp_path / "s/masks").iterdir())
    assert len(found) == FRAMES // 2
    for k, path in enumerate(found):
        assert np.array_equal(read_image(path, 1), read_image(own / f"{2 * k:06d}.png", 1))


@pytest.mark.slow
def test_segment_anything_helps_to_find_the_masks(filmed, tmp_path, cli, monkeypatch):
    """With the person's true outlines as its guesses, masks are better than without."""
    recording, height = filmed
    true = [
        read_image(recording.parent / f"truth/masks/{k:06d}.png", 1) > 127 for k in range(FRAMES)
    ]

    class Knowing:
        def __init__(self):
            self.left = iter(true)

        def find(self, image, prompt, before):
            x, y = np.floor(prompt.points[0]).astype(int)
            mask = next(self.left)
            assert mask[y, x]  # the pelvis
            return MaskGuess(mask, None, None)

    monkeypatch.setattr(SegmentAnything, "load", staticmethod(lambda path: Knowing()))
    off = {}
    (tmp_path / "config.json").write_text("{}")
    for name, more in (("alone", ()), ("both", ("--masks", tmp_path))):
        cli.works("prepare", "video", recording, tmp_path / name, "--height", height, *more)
        found = [read_image(tmp_path / f"{name}/masks/{k:06d}.png", 1) > 127 for k in range(FRAMES)]
        off[name] = sum((a != b).sum() for a, b in zip(found, true, strict=True))
    assert off["both"] < 0.9 * off["alone"]


SENTENCES = {
    "no video": (("avatar", "x.mp4", "--out", "me"), "x.mp4: no such video file or folder"),
    "no body": (("avatar", "{video}", "--out", "me", "--body", "b.npz"), "b.npz: no such file"),
    "height": (("avatar", "{video}", "--out", "me", "--height", 175), "from 0.4 to 2.6 metres"),
    "not of videos": (
        ("prepare", "video", "{video}", "me", "--frames", "m"), "--frames is not for a video",
    ),
    "of videos": (
        ("prepare", "wham", "w.pkl", "me", "--height", 1.7), "--height is for a video; got wham",
    ),
    "person": (("prepare", "video", "{video}", "me", "--person", "left"), "a number from 1 to 20"),
    "lens": (("prepare", "video", "{video}", "me", "--lens", "wide"), "--lens must be a focal"),
    "no body of poses": (("prepare", "wham", "w.pkl", "me"), "give --body"),
    "no masks": (("avatar", "{video}", "--out", "me", "--masks", "m"), "m: no such file"),
    "of a motion": (("motion", "m.npz", "o.npz", "--height", 1.7), "--height is for videos"),
}  # fmt: skip


@pytest.mark.parametrize("name", SENTENCES)
def test_what_cannot_be_done_is_one_sentence(name, tmp_path, cli, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_video(tmp_path / "f.mp4", np.zeros((2, 32, 32, 3), np.uint8))
    arguments, sentence = SENTENCES[name]
    code, _, err = cli(*(str(a).format(video="f.mp4") for a in arguments))
    lines = [line for line in err.splitlines() if "gva-mi: " in line]
    assert code == 2 and len(lines) == 1 and sentence in lines[0], err
    assert not (tmp_path / "me/subject").exists() and not (tmp_path / "o.npz").exists()
