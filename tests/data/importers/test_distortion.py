"""A lens that distorts: the subject's pictures, masks and normals are those of a pinhole."""

import importlib.util
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
    """A picture whose colours are its coordinates, also where it is interpolated."""
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


@pytest.fixture
def zju(tmp_path, thetas, world):
    """ZJU-MoCap's folder of one camera, whose lens distorts by D."""
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
    return source


def test_pictures_masks_and_normals_become_those_of_a_pinhole(zju, prepared):
    """Also normals that are arrays: they become pictures."""
    maps = zju.parent / "maps"
    for k, name in enumerate(NAMES):
        write_image(maps / name, ramp())
        if k == 2:
            (maps / name).unlink()
            np.save(maps / "2.npy", ramp() / np.float32(127.5) - 1)
    folder, said = prepared(zju, "--normals", maps, "--normals-convention", "perspective")
    assert "normals of 5 frames from maps" in said
    check(folder, D)
    u, v = straightened(D)
    seen = (u > 0) & (v > 0) & (u < WIDTH - 1) & (v < HEIGHT - 1)
    for name in NAMES[1:3]:
        found = read_image(folder / "normals" / name, 3).astype(float)
        assert np.abs(found[..., 0] - (3 * u + 20))[seen].max() <= 1
        assert np.abs(found[..., 1] - (4 * v + 10))[seen].max() <= 1


def test_links_in_a_data_set_are_followed(zju, prepared, cli):
    """A link is the user's own, such as to a larger disk."""
    elsewhere = zju.parent / "larger disk"
    (zju / "Camera_B1").rename(elsewhere)
    (zju / "Camera_B1").symlink_to(elsewhere)
    mask = zju / "mask/Camera_B1" / NAMES[1]
    mask.rename(zju.parent / "mask.png")
    mask.symlink_to(zju.parent / "mask.png")
    folder, _ = prepared(zju)
    assert not any(path.is_symlink() for path in folder.rglob("*"))
    (zju.parent / "mask.png").unlink()
    code, _, err = cli("prepare", "zju", zju, zju.parent / "b", *filmed.BUILT_IN_BODY)
    assert code == 2 and f"{mask}: no such file" in err and err.count("\n") <= 2
