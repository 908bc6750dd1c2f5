"""``gva-mi render``: cameras of a file, or on a path; before anything, or see-through."""

import copy

import numpy as np
import pytest
import torch

from gva_mi.body.pose import save_poses
from gva_mi.data.film import Film
from gva_mi.data.pictures import read_image, write_image
from gva_mi.data.video import save_cameras
from gva_mi.lock import alone_in

SMALL = ("--size", 32, 48)


@pytest.fixture
def run(run, camera):
    """The same, with a camera beside it."""
    save_cameras(run.parent / "cameras.npz", [camera])
    return run


def pictures(folder):
    return sorted(path.name for path in folder.glob("*.png"))


def test_the_videos_own_poses_by_the_cameras_of_a_file(run, cli):
    cameras, out = run.parent / "cameras.npz", run.parent / "out"
    code, said, err = cli("render", run, "--cameras", cameras, "--out", out, "--background", "red")
    assert code == 0, err
    assert pictures(out) == ["000000.png", "000001.png", "000002.png"] and "3 pictures" in said
    image = read_image(out / "000000.png", 3)
    assert image.shape == (48, 48, 3) and (image[0, 0] == (255, 0, 0)).all()


def test_on_a_turntable_by_default_and_see_through(run, cli):
    from PIL import Image

    out = run.parent / "out"
    code, _, err = cli("render", run, "--out", out, "--frames", 4, "--alpha", "--video", *SMALL)
    assert code == 0, err
    assert len(pictures(out)) == len(Film(out / "video.webm")) == 4
    assert not (out / "video.mp4").exists()
    rgba = [np.asarray(Image.open(out / name)) for name in pictures(out)]
    assert all(x.shape == (48, 32, 4) and x[0, 0, 3] == 0 and x[..., 3].max() > 200 for x in rgba)
    assert np.abs(rgba[0].astype(int) - rgba[2]).mean() > 1


def test_a_motion_plays_before_a_picture(run, cli):
    write_image(run.parent / "wall.png", np.full((6, 4, 3), (0, 0, 255), np.uint8))
    out, wall = run.parent / "out", run.parent / "wall.png"
    motion = ("--poses", run / "poses.npz", "--background", wall)
    code, _, err = cli("render", run, "--out", out, *motion, *SMALL)
    assert code == 0, err
    assert len(pictures(out)) == 3
    assert (read_image(out / "000001.png", 3)[0, 0] == (0, 0, 255)).all()


BAD = {
    "both": (("--cameras", "cameras.npz", "--path", "orbit"), "not both"),
    "size": (("--size", 10**5, 10**5), "got 100000x100000"),
    "background": (("--background", "nowhere"), "nowhere: neither a picture file nor a colour"),
    "enormous": (("--cameras", "enormous.npz"), "got 2000000x2000000"),
    "no pixels": (("--cameras", "text.npz"), "'width' must be a whole number of pixels"),
    "cameras": (("--cameras", "two.npz"), "holds 2 cameras, expected one, or one for each"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_one_sentence_and_nothing_is_written(name, run, camera, monkeypatch, cli):
    monkeypatch.chdir(run.parent)
    save_cameras(run.parent / "two.npz", [camera, camera.zoomed(2)])
    with np.load("cameras.npz") as file:
        data = dict(file)
    np.savez("enormous.npz", **data | {"width": 2_000_000, "height": 2_000_000})
    np.savez("text.npz", **data | {"width": "wide"})
    arguments, sentence = BAD[name]
    code, _, err = cli("render", "run", "--out", "out", *arguments)
    assert code == 2 and sentence in err and err.count("\n") == 1, err
    assert not (run.parent / "out").exists()


def touched(folder):
    return {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}


@pytest.mark.parametrize(("alpha", "film"), [((), "video.mp4"), (("--alpha",), "video.webm")])
def test_what_was_cut_short_is_gone_on_with_and_has_the_same_bits(alpha, film, run, cli):
    out = run.parent / "out"
    command = ("render", run, "--out", out, "--frames", 4, "--video", *alpha, *SMALL)
    code, _, err = cli(*command)
    assert code == 0, err
    wanted, times = {path.name: path.read_bytes() for path in out.iterdir()}, touched(out)
    gone = {"000002.png", "000003.png", film}
    for name in gone:
        (out / name).unlink()
    (out / "000002.png.part").write_bytes(b"cut short")
    code, said, err = cli(*command)
    assert code == 0 and f"{out}: goes on, 2 of 5 files are there" in said, err
    assert {path.name: path.read_bytes() for path in out.iterdir()} == wanted
    assert {name for name, time in touched(out).items() if time != times[name]} == gone
    code, _, err = cli(*command)  # all is there
    assert code == 2 and "already holds something; give --overwrite" in err


@pytest.mark.parametrize("other", ["background", "avatar", "poses", "camera", "marker"])
def test_another_render_is_not_gone_on_with(other, run, known, turning, cli):
    out, options = run.parent / "out", {"--poses": run / "poses.npz", "--turn": 0}
    asked = lambda: [word for pair in options.items() for word in pair]
    code, _, err = cli("render", run, "--out", out, "--path", "static", *asked(), *SMALL)
    assert code == 0, err
    (out / "000001.png").unlink()
    if other == "background":
        options["--background"] = "red"
    elif other == "avatar":
        moved = copy.deepcopy(known)
        with torch.no_grad():
            moved.canonical.means += 0.01
        moved.save(run / "avatar.npz")
    elif other == "poses":
        pose, shape = turning(3)
        pose.rotations[0, 20] += 0.1
        save_poses(run / "poses.npz", pose, shape, stage=2)
    elif other == "camera":
        options["--turn"] = 10
    else:
        (out / "render.json").write_text("[]")
    code, _, err = cli("render", run, "--out", out, "--path", "static", *asked(), *SMALL)
    assert code == 2 and "already holds something; give --overwrite to replace it" in err
    assert not (out / "000001.png").exists()


def test_two_do_not_render_into_one_folder(run, cli):
    out = run.parent / "out"
    with alone_in(out, "gva-mi render"):
        code, _, err = cli("render", run, "--out", out, *SMALL)
    assert code == 2 and "gva-mi render (process" in err and not out.exists()
