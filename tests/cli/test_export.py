"""``gva-mi export``: the suffix selects the format; errors come before any work."""

import gzip
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch
from samples.web_pages import unpack

from gva_mi.avatar.rig import digest
from gva_mi.body.pose import Pose, Shape, save_poses
from gva_mi.fit.run_folder import load_avatar
from gva_mi.splat.axes import half_turned
from gva_mi.splat.formats.gltf import Glb
from gva_mi.splat.formats.ply import load_ply
from gva_mi.splat.scene import Scene


@pytest.fixture
def dance(turning, tmp_path):
    """A motion of five frames, of another person."""
    pose, _ = turning(5, start=1.0)
    save_poses(tmp_path / "dance.npz", pose, Shape(torch.full((10,), 0.5)), stage=1)
    return tmp_path / "dance.npz"


def same(found, expected, rtol=1e-4):
    assert len(found) == len(expected)
    return torch.allclose(found.means, expected.means, rtol=rtol, atol=1e-5)


def test_gaussians_at_rest_in_a_frame_and_in_a_motion(run, dance, known, cli, turning):
    with torch.no_grad():
        expected = {(): known(Pose.rest()), ("--frame", 2): known(turning(3)[0][2]),
            ("--poses", dance, "--frame", 3): known(turning(5, 1.0)[0][3])}  # fmt: skip
    for chosen, gaussians in expected.items():
        out = cli.works("export", run, "--out", run / "a.ply", "--overwrite", *chosen)
        assert ("of a person of another shape" in out) == ("--poses" in chosen), out
        found = load_ply(run / "a.ply")
        assert same(found, half_turned(gaussians)), chosen
        assert found.sh.shape == (600, 1, 3)  # in a pose, colours follow from the light
        assert torch.allclose(found.sh, gaussians.sh, atol=1e-5)


def test_a_series_has_a_file_for_each_frame(run, dance, cli, known, turning):
    cli.works("export", run, "--series", "--poses", dance, "--out", run / "dance/walk.ply")
    files = sorted((run / "dance").iterdir())
    assert [file.name for file in files] == [f"walk{k:04d}.ply" for k in range(5)]
    with torch.no_grad():
        assert same(load_ply(files[4]), half_turned(known(turning(5, 1.0)[0][4])))
    files[4].write_text("mine")
    err = cli.fails("export", run, "--series", "--poses", dance, "--out", run / "dance/walk.ply")
    assert "walk0000.ply: exists already" in err and files[4].read_text() == "mine"


def test_poses_in_amass_form_and_a_surface_with_a_motion(run, dance, cli):
    for chosen, frames in (((), 3), (("--poses", dance, "--fps", 60), 5)):
        cli.works("export", run, "--out", run / "amass.npz", "--overwrite", *chosen)
        with np.load(run / "amass.npz") as file:
            assert file["poses"].shape == (frames, 165) and file["betas"].shape == (10,)
            assert float(file["mocap_frame_rate"]) == (60 if chosen else 30)
    for chosen in ((), ("--poses", dance)):
        cli.works("export", run, "--out", run / "a.glb", "--overwrite", *chosen)
        content = (run / "a.glb").read_bytes()
        assert content[:4] == b"glTF" and (b'"animations"' in content) == bool(chosen)


def test_an_avatar_without_its_body_needs_the_same_body(run, known, body, cli):
    shared = run.parent / "shared.npz"
    cli.works("export", run, "--no-rig", "--out", shared)
    assert shared.stat().st_size < (run / "avatar.npz").stat().st_size / 2
    with torch.no_grad():
        assert same(load_avatar(shared)(Pose.rest()), known(Pose.rest()))

    arrays = body.arrays()
    arrays["v_template"] = arrays["v_template"] * np.float32(1.01)
    np.savez(run.parent / "other.npz", **arrays)
    other = ("--body", run.parent / "other.npz")
    err = cli.fails("export", shared, "--out", run / "b.ply", *other)
    assert "belongs to 'built-in'" in err and "not to 'other'" in err
    err = cli.fails("export", run, "--no-rig", "--out", run / "b.npz", *other)
    assert f"made with another body ({digest(body)}) than other" in err
    assert not list(run.glob("b.*"))


BAD = {
    "suffix": (("--out", "a.obj"), "no format ends in .obj; expected .ply (Gaussians"),
    "frame": (("--out", "a.ply", "--frame", 3), "--frame 3 is out of range; there are 3 poses"),
    "no poses": (("--out", "a.ply", "--poses", "none.npz"), "none.npz: no such file"),
    "meaningless": (("--out", "a.ply", "--fps", 2), "is for .glb, .npz and .html, not for"),
    "no frame": (("--out", "a.html", "--frame", 1), "--frame is for .ply, .splat"),
    "two things": (("--out", "a.npz", "--no-rig", "--poses", "p.npz"), "not both"),
    "no rig": (("--out", "a.ply", "--no-rig"), "--no-rig is for .npz and .html, not for .ply"),
    "video": (("--out", "a.mp4"), "gva-mi render --video makes videos"),
    "no file": (("--out", "run/avatar.npz/a.ply"), "cannot be written to"),
    "exists": (("--out", "run/poses.npz"), "exists already; give --overwrite"),
}


def test_bad_input_is_one_sentence_and_nothing_is_written(run, monkeypatch, cli):
    monkeypatch.chdir(run.parent)
    there = lambda: sorted(p.relative_to(run.parent) for p in run.parent.rglob("*"))
    before = there()
    for arguments, sentence in BAD.values():
        cli.refuses(sentence, "export", "run", *arguments)
        assert there() == before
    (run.parent / "alone").mkdir()
    shutil.copy("run/avatar.npz", "alone")
    err = cli.fails("export", "alone/avatar.npz", "--out", "a.ply", "--frame", 0)
    assert "holds no poses.npz that were trained; give --poses" in err
    assert cli("export", "run/avatar.npz", "--out", "posed.ply", "--frame", 0)[0] == 0


def test_a_page_plays_given_motions_then_others_and_the_video(run, dance, cli):
    cli.works("export", run, "--out", run / "a.html", "--poses", dance)
    names = lambda: [motion["name"] for motion in unpack(run / "a.html")["motions"]]
    assert names() == ["dance", "walk", "dance", "the video"]
    (run / "poses.npz").unlink()  # an avatar without poses of its own still moves
    cli.works("export", run, "--out", run / "a.html", "--overwrite")
    assert names() == ["walk", "dance"]


def test_a_glb_with_gaussians_is_drawn_again(run, cli):
    """With its own first motion, and as a scene."""
    cli.works("export", run, "--splats", "--out", run / "a.glb")
    size = ("--size", 32, 40, "--path", "static")
    cli.works("render", run / "a.glb", "--out", run / "again", *size)
    assert len(list((run / "again").glob("*.png"))) == 120  # of the walk
    assert len(Scene.load(run / "a.glb").gaussians) == 600
    cli.works("export", run, "--out", run / "mesh.glb")
    cli.refuses("holds no Gaussians", "render", run / "mesh.glb", "--out", run / "none", *size)


def test_what_is_no_avatar_of_today_is_one_sentence(run, scene, cli):
    old = dict(np.load(run / "avatar.npz")) | {"format": np.array("gva_mi avatar, version 4")}
    np.savez(run / "old.npz", **old)
    foreign, file = run / "a.glb", Glb()
    primitive = file.gaussians(foreign, half_turned(load_ply(scene)))
    file.description |= {"nodes": [{"mesh": 0}], "meshes": [{"primitives": [primitive]}]}
    file.save(foreign)
    assert len(Scene.load(foreign).gaussians) == 8  # but it is a scene
    for given, sentence in (
        (run / "old.npz", "'format' must be 'gva_mi avatar, version"),
        (foreign, "a.glb: has another skeleton, or none; expected a .glb of an avatar"),
        (scene, "a .ply of points, a mesh or Gaussians; expected an avatar"),
    ):
        cli.refuses(sentence, "export", given, "--out", run / "a.html")


def test_exported_people_stand_upright_in_the_axes_of_each_format(run, known, cli):
    """By bytes: y is down in a .ply and a .splat, up in a .spz; feet of the rest pose are low."""
    up = known.canonical.means.detach()[:, 1].numpy()
    places = {}
    for name in ("a.ply", "a.splat", "a.spz"):
        cli.works("export", run, "--out", run / name, "--frame", 0)
        places[name] = (run / name).read_bytes()
    ply = np.frombuffer(places["a.ply"].split(b"end_header\n", 1)[1], "<f4").reshape(len(up), -1)
    spz = np.zeros((len(up), 3, 4), "u1")
    spz[..., 1:] = np.frombuffer(gzip.decompress(places["a.spz"]), "u1", 9 * len(up), 16).reshape(
        -1, 3, 3
    )
    splat = np.frombuffer(places["a.splat"], "<f4").reshape(len(up), 8)
    assert np.corrcoef(ply[:, 1], up)[0, 1] < -0.9
    assert np.corrcoef(spz.view("<i4")[:, 1, 0], up)[0, 1] > 0.9
    assert np.allclose(np.sort(splat[:, 1]), np.sort(ply[:, 1]))
    for axis, (k, sign) in {"z": (2, 1), "-x": (0, -1), "y": (1, 1)}.items():
        cli.works(
            "export", run, "--out", run / "up.ply", "--frame", 0, f"--up={axis}", "--overwrite"
        )
        found = load_ply(run / "up.ply").means[:, k].numpy()
        assert np.allclose(sign * found, -ply[:, 1], atol=1e-5)
    assert "--up is for .ply and .splat, not for .spz" in cli.fails(
        "export", run, "--out", run / "b.spz", "--up", "z"
    )


def test_a_person_who_lies_is_doubted(run, turning, tmp_path, cli):
    """As by poses in a world with z up."""
    pose, shape = turning(2)
    for degrees, doubts in ((0, 0), (-90, 1)):
        rotations = pose.rotations.clone()
        rotations[:, 0] = torch.tensor([np.radians(degrees), 0, 0])
        save_poses(tmp_path / "p.npz", replace(pose, rotations=rotations), shape, stage=1)
        given = ("--poses", tmp_path / "p.npz", "--overwrite")
        said = cli.works("export", run, "--out", run / "lies.ply", *given)
        assert said.count("doubtful: the person lies; expected poses in a world with") == doubts


def test_harmonics_have_the_degree_that_is_asked_for(run, cli):
    assert cli("export", run, "--out", run / "a.ply", "--sh-degree", 3)[0] == 0
    assert len((run / "a.ply").read_bytes().split(b"end_header\n", 1)[1]) == 600 * 248
    err = cli.fails("export", run, "--out", run / "e.splat", "--sh-degree", 3)
    assert "--sh-degree is for" in err
