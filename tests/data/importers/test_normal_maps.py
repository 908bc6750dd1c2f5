"""``prepare --normals FOLDER``: maps of another program, by the last number in their names."""

import json

import numpy as np
import pytest

from gva_mi.data.film import write_film
from gva_mi.data.importers.lens import centred
from gva_mi.data.normals import in_convention
from gva_mi.data.pictures import read_image, write_image
from gva_mi.data.video import load_video
from gva_mi.splat import Camera

WIDTH, HEIGHT, FRAMES = 64, 48, 5
CAMERA = Camera.from_matrices(
    centred(np.hypot(WIDTH, HEIGHT), (WIDTH, HEIGHT)), np.eye(4), WIDTH, HEIGHT
)
INSIDE = np.zeros((HEIGHT, WIDTH), bool)
INSIDE[10:40, 20:40] = True


def true_normals(k):
    """In the camera's axes, toward it: another one in each frame."""
    y, x = np.mgrid[:HEIGHT, :WIDTH] / 100.0
    n = np.stack([x - 0.3 + 0.05 * k, y - 0.2, -np.ones_like(x)], axis=-1)
    return n / np.linalg.norm(n, axis=-1, keepdims=True) * INSIDE[..., None]


def told(k, convention):
    if convention == "icon":
        return in_convention(true_normals(k), CAMERA, "icon")
    return true_normals(k) * ((1, -1, -1) if convention == "opengl" else 1)


@pytest.fixture
def maps(tmp_path):
    """Write maps under such names, as pictures or as arrays; returns their folder."""

    def write(name, convention="perspective", frames=range(FRAMES)):
        for k in frames:
            path = tmp_path / "maps" / name(k)
            if path.suffix == ".npy":
                path.parent.mkdir(exist_ok=True)
                np.save(path, told(k, convention))
            else:
                write_image(path, (told(k, convention) + 1) / 2)
        return tmp_path / "maps"

    return write


@pytest.fixture
def given(tmp_path, wham, seen, footage):
    """``prepare`` of WHAM's file, with frames frame_8 to frame_12."""
    return ["prepare", "wham", wham(_0=seen), tmp_path / "s", *footage]


def close(folder, frames, degrees):
    video = load_video(folder)
    for k in range(FRAMES):
        found = video[k].normals
        if k not in frames:
            assert found is None
            continue
        cosine = (found * true_normals(k)).sum(-1)[INSIDE]
        assert np.degrees(np.arccos(cosine.clip(-1, 1))).max() < degrees, k


@pytest.mark.parametrize(
    "convention, kind", [("perspective", "png"), ("opengl", "npy"), ("icon", "png")]
)
def test_maps_of_every_convention(convention, kind, maps, given, cli, tmp_path):
    folder = maps(lambda k: f"shot2_normal_{k + 8}.{kind}", convention)
    more = ("--normals", folder, "--normals-convention", convention)
    assert f"normals of 5 frames from maps, {convention}" in cli.works(*given, *more)
    about = json.loads((tmp_path / "s/normals.json").read_text())
    assert about == {"convention": convention}
    close(tmp_path / "s", range(FRAMES), 1.0 if kind == "png" else 0.05)


def test_frames_may_have_none_and_a_film_counts_from_0_or_1(maps, given, cli, tmp_path):
    film = tmp_path / "film.mp4"
    write_film(film, [read_image(tmp_path / f"shots/frame_{k + 8}.png", 3) for k in range(FRAMES)])
    given[given.index("--frames") + 1] = film
    more = ("--normals-convention", "perspective", "--overwrite", "--normals")
    assert cli(*given, *more, maps(lambda k: f"{k}.png", frames=(0, 3)))[0] == 0
    close(tmp_path / "s", (0, 3), 1.0)
    for path in (tmp_path / "maps").iterdir():
        path.unlink()
    assert cli(*given, *more, maps(lambda k: f"{k + 1:04d}.png"))[0] == 0
    close(tmp_path / "s", range(FRAMES), 1.0)


def spoiled(maps, what):
    name = lambda k: f"{k + 8}.png"
    folder = maps(name, "opengl" if what == "axes" else "perspective")
    if what == "astray":
        (folder / "8.png").rename(folder / "7.png")
    elif what == "twice":
        (folder / "back_8.png").write_bytes((folder / "8.png").read_bytes())
    elif what == "nameless":
        (folder / "8.png").rename(folder / "front.png")
    elif what == "size":
        write_image(folder / "9.png", np.zeros((24, 32, 3)))
    elif what == "black":
        for path in folder.iterdir():
            write_image(path, np.zeros((HEIGHT, WIDTH, 3)))
    elif what == "shares":
        (folder / "9.png").unlink()
        np.save(folder / "9.npy", (true_normals(1) + 1) / 2)
    elif what == "empty":
        for path in folder.iterdir():
            path.unlink()
    return folder


BAD = {
    "astray": "7.png: is of no frame; frames are numbered 8-12, and normals go by the last number",
    "twice": "8.png and back_8.png are both of frame 8; expected one map each",
    "nameless": "front.png: ",
    "size": "9.png: is 32x24, expected 64x48",
    "black": "maps: no pixel inside the masks is a unit vector; expected (n + 1) / 2 in pictures",
    "shares": "9.npy: holds no number below 0, such as (n + 1) / 2; expected n",
    "axes": "most normals look away from the camera if they are perspective; expected another",
    "empty": "maps: holds no normals (.png",
}


@pytest.mark.parametrize("what", BAD)
def test_bad_maps_are_refused_in_one_sentence(what, maps, given, cli, tmp_path):
    more = ("--normals", spoiled(maps, what), "--normals-convention", "perspective")
    err = cli.fails(*given, *more)
    assert BAD[what] in err and err.count("\n") <= 2, err
    assert not (tmp_path / "s").exists()


def test_a_convention_is_asked_for(maps, given, cli, tmp_path):
    folder = maps(lambda k: f"{k + 8}.png")
    assert "--normals needs --normals-convention" in cli.fails(*given, "--normals", folder)
    assert not (tmp_path / "s").exists()
