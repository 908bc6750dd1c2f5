"""Data sets of a few frames: the person stands where the camera saw them.

Those of many cameras are in test_multi_view.py.
"""

import importlib.util
import json
import pickle
from pathlib import Path

import numpy as np
import pytest

from gva_mi.core.errors import InputError
from gva_mi.data.importers.capture import read_ranges
from gva_mi.data.importers.datasets import dataset_of
from gva_mi.data.importers.distortion import undistort
from gva_mi.data.pictures import read_image, write_image, write_movie
from gva_mi.data.video import load_video

spec = importlib.util.spec_from_file_location("filmed", Path(__file__).with_name("filmed.py"))
filmed = importlib.util.module_from_spec(spec)
spec.loader.exec_module(filmed)

WIDTH, HEIGHT, FRAMES, SMPL = filmed.WIDTH, filmed.HEIGHT, filmed.FRAMES, filmed.SMPL
K, TURN, MOVE, MASK, BUILT_IN_BODY = (
    filmed.K,
    filmed.TURN,
    filmed.MOVE,
    filmed.MASK,
    filmed.BUILT_IN_BODY,
)
matrices, shots = filmed.matrices, filmed.shots


@pytest.fixture
def snapshot(tmp_path, thetas, world):
    """People-Snapshot: a film, masks and poses in HDF5, a pickle of Python 2 with the camera."""
    h5py = pytest.importorskip("h5py")
    folder = tmp_path / "male-3-casual"
    folder.mkdir()
    write_movie(folder / "male-3-casual.mp4", shots())
    with h5py.File(folder / "masks.hdf5", "w") as file:
        masks = file.create_dataset(
            "masks", (FRAMES, HEIGHT, WIDTH), "b", chunks=True, compression="lzf"
        )
        masks[:] = MASK > 0
    with h5py.File(folder / "reconstructed_poses.hdf5", "w") as file:
        for name, x in (("pose", thetas), ("trans", world[1] - SMPL), ("betas", np.zeros(10))):
            file.create_dataset(name, data=x.astype("f4"), chunks=True, compression="lzf")
    camera = {
        "camera_t": MOVE, "camera_rt": TURN, "camera_f": K[[0, 1], [0, 1]], "camera_c": K[:2, 2],
        "camera_k": np.zeros(5), "width": WIDTH, "height": HEIGHT,
    }  # fmt: skip
    (folder / "camera.pkl").write_bytes(pickle.dumps(camera, protocol=2))
    return folder


def test_people_snapshot(snapshot, seen, prepared, stands):
    folder, said = prepared(snapshot)
    assert "snapshot, SMPL, 5 frames of 64x48" in said
    video = stands(folder, *seen, K)
    assert np.array_equal(video[2].mask > 0.5, MASK > 0)
    assert np.array_equal(read_image(folder / "frames/000003.png", 3), shots()[3])


def test_people_snapshot_of_a_protocol(snapshot, tmp_path, prepared, cli):
    """InstantAvatar's own file, cut short; poses beyond the film are left out, and it is said."""
    ranges = tmp_path / "male-3-casual.yaml"
    ranges.write_text(
        "name: peoplesnapshot\nopt:\n  dataroot: ./data/\n  train:\n    num_workers: 8\n"
        "    start: 0\n    end: 2\n    skip: 2\n    sampler: ${sampler}\n  val:\n    start: 3\n"
        "    end: 3\n  test:\n    start: 3\n    end: 9\n    skip: 1\n"
    )
    write_movie(snapshot / "male-3-casual.mp4", shots()[:4])
    folder, said = prepared(snapshot, "--splits", ranges)
    assert "5 poses, but 4 pictures with masks" in said
    assert json.loads((folder / "splits.json").read_text()) == {"train": [0, 2], "test": [3]}
    assert load_video(folder).splits.test == [3]
    for text, words in (
        ("train:\n  start: 0\n", "train must have start and end"),
        ("train:\n  start: 0\n  end: 2\ntest:\n  start: 7\n  end: 9\n", "the video has frames 0"),
        ("train:\n  start: 0\n  end: 2\ntest:\n  start: 2\n  end: 3\n", "frame 2 is both"),
    ):
        ranges.write_text(text)
        with pytest.raises(InputError, match=words):
            read_ranges(ranges, 4)


def test_people_snapshot_without_distortion(snapshot, prepared):
    """A mask in the middle stays; at the border of the picture the lens bent it."""
    found = pickle.loads((snapshot / "camera.pkl").read_bytes())
    found["camera_k"] = np.array([0.3, 0.05, 0.01, -0.02, 0.0])
    (snapshot / "camera.pkl").write_bytes(pickle.dumps(found, protocol=2))
    folder, _ = prepared(snapshot)
    straight = read_image(folder / "masks/000000.png", 1)
    wanted = undistort("x", K, found["camera_k"], (WIDTH, HEIGHT))(MASK)
    assert np.array_equal(straight, wanted) and not np.array_equal(straight, MASK)


def test_a_straight_line_is_straight_again():
    """A dot that the lens shows at the distorted place is found where a pinhole shows it."""
    k = (0.2, -0.1, 0.01, 0.02, 0.05)
    for x, y in ((0.2, 0.1), (-0.25, 0.2), (0.3, -0.2)):
        r2 = x * x + y * y
        radial = 1 + k[0] * r2 + k[1] * r2**2 + k[4] * r2**3
        bent = np.array([
            x * radial + 2 * k[2] * x * y + k[3] * (r2 + 2 * x * x),
            y * radial + k[2] * (r2 + 2 * y * y) + 2 * k[3] * x * y,
        ])  # fmt: skip
        v, u = np.meshgrid(np.arange(HEIGHT) + 0.5, np.arange(WIDTH) + 0.5, indexing="ij")
        at = bent * K[[0, 1], [0, 1]] + K[:2, 2]
        dot = np.exp(-((u - at[0]) ** 2 + (v - at[1]) ** 2) / 8)
        found = (
            undistort("x", K, np.array(k), (WIDTH, HEIGHT))((dot * 255).astype(np.uint8)) / 255.0
        )
        centre = np.array([(found * u).sum(), (found * v).sum()]) / found.sum()
        wanted = np.array([x, y]) * K[[0, 1], [0, 1]] + K[:2, 2]
        assert np.abs(centre - wanted).max() < 0.15
    with pytest.raises(InputError, match="distortion must be"):
        undistort("x", K, np.zeros(3), (WIDTH, HEIGHT))


HOSTILE = {
    "an external link": "is a link to somewhere else",
    "a soft link": "is a link to somewhere else",
    "a virtual array": "lies in other files",
    "an external array": "lies in other files",
    "a giant block": "claims blocks of",
    "text": "must be an array of numbers",
    "a folder": "must be an array of numbers",
    "other axes": r"must be (T, H, W), got (5,)",
    "another name": "has no array 'masks'; found: other",
    "no file": "damaged, or no HDF5 file",
}


@pytest.mark.parametrize("case", HOSTILE)
def test_hdf5_that_leads_elsewhere_is_refused(snapshot, tmp_path, cli, case):
    import h5py

    path = snapshot / "masks.hdf5"
    kept = path.rename(tmp_path / "kept.hdf5")
    with h5py.File(path, "w") as file:
        if case == "an external link":
            file["masks"] = h5py.ExternalLink(str(kept), "/masks")
        elif case == "a soft link":
            file["x"] = np.zeros((FRAMES, HEIGHT, WIDTH))
            file["masks"] = h5py.SoftLink("/x")
        elif case == "a virtual array":
            layout = h5py.VirtualLayout((FRAMES, HEIGHT, WIDTH), "b")
            layout[:] = h5py.VirtualSource(str(kept), "masks", (FRAMES, HEIGHT, WIDTH))
            file.create_virtual_dataset("masks", layout)
        elif case == "an external array":
            place = [(str(kept), 0, FRAMES * HEIGHT * WIDTH)]
            file.create_dataset("masks", (FRAMES, HEIGHT, WIDTH), "b", external=place)
        elif case == "a giant block":
            size = (1 << 20, HEIGHT, WIDTH)
            file.create_dataset("masks", size, "b", chunks=size, compression="gzip")
        elif case == "a folder":
            file.create_group("masks")
        else:
            shape = {"other axes": np.zeros(FRAMES), "text": "a"}.get(case, np.zeros((2, 2, 2)))
            file["other" if case == "another name" else "masks"] = shape
    if case == "no file":
        path.write_bytes(b"\x89HDF\r\n\x1a\nand then nothing")
    code, _, err = cli("prepare", "auto", snapshot, tmp_path / "s", *BUILT_IN_BODY)
    assert code == 2 and HOSTILE[case] in err and err.count("\n") <= 2, err
    assert not (tmp_path / "s").exists()


def test_hdf5_needs_a_package(snapshot, tmp_path, cli, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "h5py", None)
    code, _, err = cli("prepare", "snapshot", snapshot, tmp_path / "s", *BUILT_IN_BODY)
    assert code == 2 and "needs the package h5py to be read; pip install 'gva_mi[hdf5]'" in err


@pytest.mark.parametrize("form", ["thetas", "parts"])
def test_instantavatar(tmp_path, seen, thetas, world, prepared, stands, form):
    source = tmp_path / "male-3-casual"
    for k, shot in enumerate(shots()):
        write_image(source / f"images/image_{k:04d}.png", shot)
        if form == "thetas":
            (source / "masks").mkdir(exist_ok=True)
            np.save(source / f"masks/mask_{k:04d}.npy", (MASK > 0).astype(np.uint8))
        else:
            write_image(source / f"masks/mask_{k:04d}.png", MASK)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = matrices(TURN), MOVE
    np.savez(source / "cameras.npz", intrinsic=K, extrinsic=T, height=HEIGHT, width=WIDTH)
    poses = {"thetas": thetas} if form == "thetas" else {
        "global_orient": thetas[:, :3], "body_pose": thetas[:, 3:]
    }  # fmt: skip
    name = "poses.npz" if form == "thetas" else "poses_optimized.npz"
    np.savez(source / name, betas=np.zeros(10, "f4"), transl=world[1] - SMPL, **poses)
    folder, said = prepared(source)
    assert "instantavatar, SMPL" in said
    video = stands(folder, *seen, K)
    assert np.array_equal(video[1].mask > 0.5, MASK > 0)


def test_a_folder_that_is_no_data_set_is_refused(tmp_path, cli):
    (tmp_path / "x").mkdir()
    assert dataset_of(tmp_path / "x") is None
    code, _, err = cli("prepare", "auto", tmp_path / "x", tmp_path / "s", *BUILT_IN_BODY)
    assert code == 2 and "brings no frames of its own; give --frames" in err
    code, _, err = cli("prepare", "zju", tmp_path / "x", tmp_path / "s", *BUILT_IN_BODY)
    assert code == 2 and "not of the kind zju; expected a folder with annots.npy" in err
