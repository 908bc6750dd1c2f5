"""Data sets that one camera filmed: the person stands where it saw them; distorted lenses."""

import numpy as np
import pytest
from samples import data_sets as filmed

from gva_mi.core.errors import InputError
from gva_mi.readers.datasets import dataset_of
from gva_mi.subject.lens import undistort
from gva_mi.subject.pictures import read_image, write_image
from gva_mi.subject.video import load_video

WIDTH, HEIGHT, FRAMES = 64, 48, 5


@pytest.mark.parametrize("form", ["thetas", "parts"])
def test_instantavatar(tmp_path, seen, thetas, world, prepared, stands, form):
    """In one form with pictures of half the calibration's size, by which K is scaled."""
    source, larger = tmp_path / "male-3-casual", 1 if form == "thetas" else 2
    for k, shot in enumerate(filmed.shots()):
        write_image(source / f"images/image_{k:04d}.png", shot)
        if form == "thetas":
            (source / "masks").mkdir(exist_ok=True)
            np.save(source / f"masks/mask_{k:04d}.npy", (filmed.MASK > 0).astype(np.uint8))
        else:
            write_image(source / f"masks/mask_{k:04d}.png", filmed.MASK)
    count = FRAMES if form == "thetas" else FRAMES - 1
    for path in sorted(source.glob("masks/*"))[count:]:
        path.unlink()  # poses beyond the pictures with masks are left out
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = filmed.matrices(filmed.TURN), filmed.MOVE
    size = {"height": larger * HEIGHT, "width": larger * WIDTH}
    K = filmed.K * [[larger], [larger], [1]]
    np.savez(source / "cameras.npz", intrinsic=K, extrinsic=T, **size)
    poses = {"thetas": thetas} if form == "thetas" else {
        "global_orient": thetas[:, :3], "body_pose": thetas[:, 3:]
    }  # fmt: skip
    name = "poses.npz" if form == "thetas" else "poses_optimized.npz"
    np.savez(source / name, betas=np.zeros(10, "f4"), transl=world[1] - filmed.SMPL, **poses)
    folder, said = prepared(source)
    assert "instantavatar, SMPL" in said
    assert ("5 poses, but 4 pictures with masks" in said) == (form == "parts")
    video = stands(folder, *(x[:count] for x in seen), filmed.K)
    assert np.array_equal(video[1].mask > 0.5, filmed.MASK > 0)


def test_a_camera_without_distortion_is_a_pinhole(tmp_path, seen, thetas, world, prepared, stands):
    source = filmed.zju(tmp_path / "x", thetas, world[1])
    annots = np.load(source / "annots.npy", allow_pickle=True).item()
    del annots["cams"]["D"]
    np.save(source / "annots.npy", annots)
    stands(prepared(source)[0], *seen, filmed.K)


def test_a_folder_that_is_no_data_set_is_refused(tmp_path, cli):
    (tmp_path / "x").mkdir()
    assert dataset_of(tmp_path / "x") is None
    for kind, words in (
        ("auto", "brings no frames of its own; give --frames"),
        ("zju", "not a data set of zju; expected a folder with annots.npy"),
    ):
        err = cli.fails("prepare", kind, tmp_path / "x", tmp_path / "s", *filmed.BUILT_IN_BODY)
        assert words in err


D = np.array([0.12, -0.05, 0.01, -0.008, 0.02])


def ramp():
    """A picture whose colours are its coordinates, also where it is interpolated."""
    x, y = np.meshgrid(3.0 * np.arange(WIDTH) + 20, 4.0 * np.arange(HEIGHT) + 10)
    return np.stack([x, y, 0 * x], axis=-1).round().astype(np.uint8)


def straightened(K):
    """Where in the ramp, in pixels, a pinhole's pixels are: Brown's model as OpenCV prints it."""
    k1, k2, p1, p2, k3 = D
    u, v = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    x, y = (u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1]
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    bent_x = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    bent_y = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    return K[0, 0] * bent_x + K[0, 2] - 0.5, K[1, 1] * bent_y + K[1, 2] - 0.5


def test_pictures_and_masks_become_those_of_a_pinhole(tmp_path, thetas, world, prepared):
    distorted = {"D": D[:, None], "images": [ramp()] * FRAMES}
    folder, _ = prepared(filmed.zju(tmp_path / "x", thetas, world[1], **distorted))
    u, v = straightened(filmed.K)
    assert max(np.abs(u - np.arange(WIDTH)).max(), np.abs(v.T - np.arange(HEIGHT)).max()) > 1
    seen = (u > 0) & (v > 0) & (u < WIDTH - 1) & (v < HEIGHT - 1)
    assert seen.mean() > 0.7
    found = read_image(folder / "frames/000002.png", 3).astype(float)
    assert np.abs(found[..., 0] - (3 * u + 20))[seen].max() <= 1
    assert np.abs(found[..., 1] - (4 * v + 10))[seen].max() <= 1
    video = load_video(folder)
    inside = (u > 19.5) & (u < 39.5) & (v > 9.5) & (v < 39.5)
    assert ((video[2].mask > 0.5) != inside).mean() < 0.01
    assert np.abs(video.cameras[2].K - filmed.K).max() < 1e-6
    with pytest.raises(InputError, match="distortion must be"):
        undistort("x", filmed.K, np.zeros(3), (WIDTH, HEIGHT))
