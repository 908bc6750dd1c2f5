"""``gva-mi render``: cameras of a file or on a path; over a background, or transparent."""

import numpy as np
import pytest

from gva_mi.body.pose import save_poses
from gva_mi.subject.cameras import save_cameras
from gva_mi.subject.pictures import read_image, write_image
from gva_mi.subject.video_file import VideoFile

SMALL = ("--size", 32, 48)


@pytest.fixture
def run(run, camera):
    """A run's folder with a camera beside it."""
    save_cameras(run.parent / "cameras.npz", [camera])
    return run


def pictures(folder):
    return sorted(path.name for path in folder.glob("*.png"))


def test_trained_poses_are_seen_by_the_cameras_of_a_file(run, cli):
    cameras, out = run.parent / "cameras.npz", run.parent / "out"
    said = cli.works("render", run, "--cameras", cameras, "--out", out, "--background", "red")
    assert pictures(out) == ["000000.png", "000001.png", "000002.png"] and "3 pictures" in said
    image = read_image(out / "000000.png", 3)
    assert image.shape == (48, 48, 3) and (image[0, 0] == (255, 0, 0)).all()


def test_alpha_is_transparent(run, cli):
    from PIL import Image

    out = run.parent / "out"
    given = ("render", run, "--out", out, "--path", "orbit", "--alpha", *SMALL)
    assert "a video cannot be transparent" in cli.fails(*given, "--video")
    cli.works(*given)
    assert len(pictures(out)) == 3
    wanted = [np.asarray(Image.open(out / name)) for name in pictures(out)]
    assert all(x.shape == (48, 32, 4) and x[0, 0, 3] == 0 and x[..., 3].max() > 200 for x in wanted)
    assert np.abs(wanted[0].astype(int) - wanted[1]).mean() > 1


def test_a_video_over_a_picture(run, cli):
    write_image(run.parent / "wall.png", np.full((10, 90, 3), (0, 0, 255), np.uint8))
    out = ("--out", run.parent / "out", "--background", run.parent / "wall.png", "--video")
    cli.works("render", run, *out, "--path", "orbit", *SMALL)
    images = VideoFile(run.parent / "out/video.mp4")
    assert len(images) == 3 and images[0].shape == (48, 32, 3)
    assert np.abs(images[0][:3, :3].astype(int) - (0, 0, 255)).max() < 25
    assert np.abs(images[0].astype(int) - (0, 0, 255)).max() > 60  # somebody is there


BAD = {
    "both": (("--cameras", "cameras.npz", "--path", "orbit"), "not both"),
    "size": (("--size", 10**5, 10**5), "got 100000x100000"),
    "background": (("--background", "nowhere"), "nowhere: neither a picture file nor a colour"),
    "enormous": (("--cameras", "enormous.npz"), "got 2000000x2000000"),
    "no pixels": (("--cameras", "text.npz"), "'width' must be a whole number of pixels"),
    "cameras": (("--cameras", "two.npz"), "holds 2 cameras, expected one, or one for each"),
}


def test_bad_input_is_one_sentence_and_nothing_is_written(run, camera, monkeypatch, cli):
    monkeypatch.chdir(run.parent)
    save_cameras(run.parent / "two.npz", [camera, camera.zoomed(2)])
    data = dict(np.load("cameras.npz"))
    np.savez("enormous.npz", **data | {"width": 2_000_000, "height": 2_000_000})
    np.savez("text.npz", **data | {"width": "wide"})
    for arguments, sentence in BAD.values():
        cli.refuses(sentence, "render", "run", "--out", "out", *arguments)
        assert not (run.parent / "out").exists()


def touched(folder):
    return {path.name: path.stat().st_mtime_ns for path in folder.iterdir()}


def test_an_interrupted_render_is_resumed_with_the_same_bits(run, cli):
    out = run.parent / "out"
    command = ("render", run, "--out", out, "--path", "orbit", "--video", *SMALL)
    cli.works(*command)
    wanted, times = {path.name: path.read_bytes() for path in out.iterdir()}, touched(out)
    gone = {"000001.png", "000002.png", "video.mp4"}
    for name in gone:
        (out / name).unlink()
    (out / "000002.png.part").write_bytes(b"cut short")
    assert f"{out}: resumed, 1 of 4 files exist" in cli.works(*command)
    assert {path.name: path.read_bytes() for path in out.iterdir()} == wanted
    assert {name for name, time in touched(out).items() if time != times[name]} == gone
    err = cli.fails(*command)  # nothing is missing
    assert "already holds something; give --overwrite" in err


def test_a_render_with_other_inputs_is_not_resumed(run, turning, cli):
    out = run.parent / "out"
    command = ("render", run, "--out", out, "--path", "static", *SMALL)
    cli.works(*command, "--poses", run / "poses.npz")
    (out / "000001.png").unlink()
    pose, shape = turning(3)
    pose.rotations[0, 20] += 0.1
    save_poses(run / "other.npz", pose, shape, stage=2)
    for poses, more in (("poses", ("--background", "red")), ("poses", ("--turn", 10)),
                        ("other", ())):  # fmt: skip
        err = cli.fails(*command, "--poses", run / f"{poses}.npz", *more)
        assert "already holds something; give --overwrite to replace it" in err
        assert not (out / "000001.png").exists()
    cli.works(*command, "--poses", run / "poses.npz")
