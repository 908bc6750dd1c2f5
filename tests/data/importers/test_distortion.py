"""Data sets whose lens distorts: the subject's pictures and masks are those of a pinhole."""

import importlib.util
import json
import pickle
from pathlib import Path

import numpy as np
import pytest

from gva_mi.data.pictures import read_image, write_image
from gva_mi.data.video import load_video

spec = importlib.util.spec_from_file_location("filmed", Path(__file__).with_name("filmed.py"))
filmed = importlib.util.module_from_spec(spec)
spec.loader.exec_module(filmed)

WIDTH, HEIGHT, FRAMES, K = filmed.WIDTH, filmed.HEIGHT, filmed.FRAMES, filmed.K
HALF = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])  # OpenCV's first pixel is centred at 0
D = np.array([0.12, -0.05, 0.01, -0.008, 0.02])
NAMES = [f"{k:06d}.png" for k in range(FRAMES)]
PLACES = 3.0 * np.arange(WIDTH) + 20, 4.0 * np.arange(HEIGHT) + 10  # what a pixel shows of x, y


def ramp():
    """A picture that tells of each of its points where it is: interpolated, it still does."""
    x, y = np.meshgrid(*PLACES)
    return np.stack([x, y, 0 * x], axis=-1).round().astype(np.uint8)


def straightened(d):
    """Where in the ramp, in pixels, a pinhole's pixels are: Brown's model as OpenCV prints it."""
    k1, k2, p1, p2, k3 = d
    u, v = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    x, y = (u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1]
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    bent_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    bent_y = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    return K[0, 0] * bent_x + K[0, 2] - 0.5, K[1, 1] * bent_y + K[1, 2] - 0.5


def check(folder, d):
    """Pictures and masks are resampled; the camera is the same pinhole."""
    u, v = straightened(d)
    assert max(np.abs(u - np.arange(WIDTH)).max(), np.abs(v.T - np.arange(HEIGHT)).max()) > 1
    seen = (u > 0) & (v > 0) & (u < WIDTH - 1) & (v < HEIGHT - 1)
    assert seen.mean() > 0.7
    found = read_image(folder / "frames/000002.png", 3).astype(float)
    assert np.abs(found[..., 0] - (3 * u + 20))[seen].max() <= 1
    assert np.abs(found[..., 1] - (4 * v + 10))[seen].max() <= 1
    video = load_video(folder)
    inside = (u > 19.5) & (u < 39.5) & (v > 9.5) & (v < 39.5)
    assert ((video[2].mask > 0.5) != inside).mean() < 0.01
    assert np.abs(video.cameras[2].K - K).max() < 1e-6


def test_zju(tmp_path, thetas, world, prepared):
    source = tmp_path / "CoreView"
    (source / "params").mkdir(parents=True)
    for k, name in enumerate(NAMES):
        write_image(source / "Camera_B1" / name, ramp())
        write_image(source / "mask/Camera_B1" / name, filmed.MASK)
        params = {"poses": thetas[k : k + 1], "Rh": np.zeros((1, 3)), "Th": world[1][k : k + 1],
                  "shapes": np.zeros((1, 10))}  # fmt: skip
        np.save(source / f"params/{k}.npy", params)
    cams = {"K": [K - HALF], "D": [D[:, None]], "R": [filmed.matrices(filmed.TURN)],
            "T": [1000 * filmed.MOVE[:, None]]}  # fmt: skip
    ims = [{"ims": [f"Camera_B1/{name}"]} for name in NAMES]
    np.save(source / "annots.npy", {"cams": cams, "ims": ims})
    check(prepared(source, kind="zju")[0], D)


@pytest.mark.parametrize("name", ["dist", "D"])
def test_easymocap(name, tmp_path, thetas, world, prepared):
    source = tmp_path / "scene"
    (source / "smpl").mkdir(parents=True)
    for k, picture in enumerate(NAMES):
        write_image(source / "images/1" / picture, ramp())
        write_image(source / "mask/1" / picture, filmed.MASK)
        person = {"id": 0, "Rh": [[0.0] * 3], "Th": [world[1][k].tolist()],
                  "poses": [thetas[k].tolist()], "shapes": [[0.0] * 10]}  # fmt: skip
        (source / f"smpl/{k:06d}.json").write_text(json.dumps([person]))
    yaml(source / "intri.yml", {"K_1": K - HALF, f"{name}_1": D})
    rotation = filmed.matrices(filmed.TURN)
    yaml(source / "extri.yml", {"Rot_1": rotation, "T_1": filmed.MOVE[:, None]})
    check(prepared(source)[0], D)


def yaml(path, matrices):
    """OpenCV's."""
    text = "%YAML:1.0\n---\n"
    for name, x in matrices.items():
        x = np.atleast_2d(x)
        numbers = ", ".join(f"{value:.9f}" for value in x.ravel())
        text += f"{name}: !!opencv-matrix\n  rows: {x.shape[0]}\n  cols: {x.shape[1]}\n"
        text += f"  dt: d\n  data: [{numbers}]\n"
    path.write_text(text)


@pytest.fixture
def neuman(tmp_path, thetas):
    """NeuMan's folder with a lens (or several) of COLMAP's; pictures go round the lenses."""

    def write(*lenses):
        source = tmp_path / "bike"
        alignments, images = {}, []
        for k, name in enumerate(NAMES):
            write_image(source / "images" / name, ramp())
            write_image(source / "segmentations" / name, 255 - filmed.MASK)
            alignments[name] = np.concatenate([np.eye(3), [[0, 0, 4]]])
            images += [f"{k} 1 0 0 0 0 0 0 {k % len(lenses)} {name}", "1.0 2.0 -1"]
        (source / "sparse").mkdir()
        (source / "sparse/images.txt").write_text("\n".join(images))
        lines = [f"{i} {m} {WIDTH} {HEIGHT} {numbers}" for i, (m, numbers) in enumerate(lenses)]
        (source / "sparse/cameras.txt").write_text("\n".join(lines))
        np.save(source / "alignments.npy", alignments)
        people = {1: {"pose": thetas, "betas": np.zeros((FRAMES, 10))}}
        (source / "smpl_output_romp.pkl").write_bytes(pickle.dumps(people))
        return source

    return write


@pytest.mark.parametrize("model", ["SIMPLE_RADIAL", "RADIAL", "OPENCV"])
def test_neuman(model, neuman, prepared, monkeypatch):
    one = np.array([[72.0, 0, 33], [0, 72, 23], [0, 0, 1]])
    monkeypatch.setitem(globals(), "K", K if model == "OPENCV" else one)
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    numbers, d = {
        "SIMPLE_RADIAL": (f"{fx} {cx} {cy} 0.2", [0.2, 0, 0, 0, 0]),
        "RADIAL": (f"{fx} {cx} {cy} 0.2 -0.1", [0.2, -0.1, 0, 0, 0]),
        "OPENCV": (f"{fx} {fy} {cx} {cy} 0.12 -0.05 0.01 -0.008", [0.12, -0.05, 0.01, -0.008, 0]),
    }[model]
    check(prepared(neuman((model, numbers)))[0], d)


def test_normals_of_a_folder_are_straightened_with_the_pictures(neuman, prepared):
    """Also those that are no pictures: they become some."""
    source, maps = neuman(("OPENCV", f"{K[0, 0]} {K[1, 1]} 33 23 0.2 0 0 0")), "maps"
    for k, name in enumerate(NAMES):
        write_image(source.parent / maps / name, ramp())
        if k == 2:
            (source.parent / maps / name).unlink()
            np.save(source.parent / maps / "2.npy", ramp() / np.float32(127.5) - 1)
    more = ("--normals", source.parent / maps, "--normals-convention", "perspective")
    folder, said = prepared(source, *more)
    assert "normals of 5 frames from maps" in said
    u, v = straightened([0.2, 0, 0, 0, 0])
    seen = (u > 0) & (v > 0) & (u < WIDTH - 1) & (v < HEIGHT - 1)
    for name in NAMES[1:3]:
        found = read_image(folder / "normals" / name, 3).astype(float)
        assert np.abs(found[..., 0] - (3 * u + 20))[seen].max() <= 1
        assert np.abs(found[..., 1] - (4 * v + 10))[seen].max() <= 1


def test_lenses_that_differ_are_refused_only_where_they_distort(neuman, cli, tmp_path):
    source = neuman(("SIMPLE_RADIAL", "70 33 23 0.2"), ("SIMPLE_RADIAL", "70 33 23 0.1"))
    out = tmp_path / "s"
    code, _, err = cli("prepare", "neuman", source, out, *filmed.PUPPET)
    assert code == 2 and "lenses with distortion that differ from picture to picture" in err
    assert err.count("\n") <= 2 and not out.exists()
    lenses = "\n".join(f"{i} SIMPLE_RADIAL {WIDTH} {HEIGHT} {70 + i} 33 23 0" for i in range(2))
    (source / "sparse/cameras.txt").write_text(lenses)
    code, _, err = cli("prepare", "neuman", source, out, *filmed.PUPPET)
    assert code == 0, err
    assert np.array_equal(read_image(out / "frames/000001.png", 3), ramp())


def test_links_of_a_data_set_are_followed_and_names_that_leave_it_are_not(neuman, prepared, cli):
    """A link is the user's own, such as to a larger disk; a path in a file is its writer's."""
    source = neuman(("PINHOLE", "70 72 33 23"))
    elsewhere = source.parent / "larger disk"
    (source / "images").rename(elsewhere)
    (source / "images").symlink_to(elsewhere)
    mask = source / "segmentations" / NAMES[1]
    mask.rename(source.parent / "mask.png")
    mask.symlink_to(source.parent / "mask.png")
    folder, _ = prepared(source)
    assert np.array_equal(read_image(folder / "frames/000001.png", 3), ramp())
    assert not any(path.is_symlink() for path in folder.rglob("*"))
    (source.parent / "mask.png").unlink()
    code, _, err = cli("prepare", "neuman", source, source.parent / "b", *filmed.PUPPET)
    assert code == 2 and f"{mask}: no such file" in err and err.count("\n") <= 2
