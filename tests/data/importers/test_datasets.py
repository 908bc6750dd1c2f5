"""Data sets as they are in the wild, of a few frames: the person stands where the camera saw."""

import json
import pickle

import numpy as np
import pytest
import roma
import torch

from gva_mi.body.puppet import PUPPET as PUPPET_FILE
from gva_mi.body.smplx import load_body
from gva_mi.data.importers.datasets import dataset_of
from gva_mi.data.importers.lenses import pinhole
from gva_mi.data.importers.recordings import read_ranges
from gva_mi.data.pictures import read_image, write_image, write_movie
from gva_mi.data.video import load_video
from gva_mi.data.views import held_out_views
from gva_mi.errors import InputError

WIDTH, HEIGHT, FRAMES = 64, 48, 5
SMPL, SMPLX = np.array([-0.0018, -0.2233, 0.0282]), np.array([0.0031, -0.3514, 0.0120])
K = np.array([[70.0, 0, 33], [0, 72, 23], [0, 0, 1]])
TURN, MOVE = np.array([0.1, -0.4, 0.05]), np.array([0.2, 0.1, 0.5])
PUPPET = ("--body", "puppet")
MASK = np.zeros((HEIGHT, WIDTH), np.uint8)
MASK[10:40, 20:40] = 255


def matrices(rotations):
    return roma.rotvec_to_rotmat(torch.as_tensor(rotations, dtype=torch.float64)).numpy()


def vectors(R):
    return roma.rotmat_to_rotvec(torch.as_tensor(R, dtype=torch.float64)).numpy()


@pytest.fixture
def world(seen):
    """In a world that TURN and MOVE take to the camera: roots (T, 3) and pelvises (T, 3)."""
    rotations, places = seen
    R = matrices(TURN)
    return vectors(R.T @ matrices(rotations[:, 0])), (places - MOVE) @ R


@pytest.fixture
def thetas(seen, world):
    """SMPL's poses in that world (T, 72)."""
    body = np.concatenate([seen[0][:, 1:22], np.ones((FRAMES, 2, 3))], axis=1)
    return np.concatenate([world[0], body.reshape(FRAMES, 69)], axis=1)


def shots():
    random = np.random.default_rng(0)
    return [random.integers(0, 255, (HEIGHT, WIDTH, 3), dtype=np.uint8) for _ in range(FRAMES)]


@pytest.fixture
def prepared(tmp_path, cli):
    def run(source, *more, kind="auto"):
        code, said, err = cli("prepare", kind, source, tmp_path / "s", *PUPPET, *more)
        assert code == 0, err
        return tmp_path / "s", said

    return run


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
    wanted = pinhole("x", K, found["camera_k"], (WIDTH, HEIGHT))(MASK)
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
        found = pinhole("x", K, np.array(k), (WIDTH, HEIGHT))((dot * 255).astype(np.uint8)) / 255.0
        centre = np.array([(found * u).sum(), (found * v).sum()]) / found.sum()
        wanted = np.array([x, y]) * K[[0, 1], [0, 1]] + K[:2, 2]
        assert np.abs(centre - wanted).max() < 0.15
    with pytest.raises(InputError, match="distortion must be"):
        pinhole("x", K, np.zeros(3), (WIDTH, HEIGHT))


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
    code, _, err = cli("prepare", "auto", snapshot, tmp_path / "s", *PUPPET)
    assert code == 2 and HOSTILE[case] in err and err.count("\n") <= 2, err
    assert not (tmp_path / "s").exists()


def test_hdf5_needs_a_package(snapshot, tmp_path, cli, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "h5py", None)
    code, _, err = cli("prepare", "snapshot", snapshot, tmp_path / "s", *PUPPET)
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


def about_origin(thetas, world):
    """EasyMocap's Rh and Th: the body turns about the origin and not about its pelvis."""
    return thetas[:, :3], world[1] - np.einsum("nij,j->ni", matrices(thetas[:, :3]), SMPL)


@pytest.mark.parametrize("named", ["number", "core view"])
def test_zju_mocap(tmp_path, seen, thetas, world, prepared, stands, cli, named):
    source = tmp_path / "CoreView"
    Rh, Th = about_origin(thetas, world)
    names = []
    for k, shot in enumerate(shots()):
        stem = f"{k + 7:06d}" if named == "number" else f"CoreView_313_Camera_(2)_{k + 7:04d}_2019"
        names.append([f"Camera_B1/{stem}.jpg", f"Camera_B2/{stem}.jpg"])
        write_image(source / names[-1][1], shot)
        mask = source / "mask_cihp" / names[-1][1].replace(".jpg", ".png")
        write_image(mask, MASK // 255 * 13)  # a part of the body by number
        pose = np.concatenate([np.zeros(3), thetas[k, 3:]])
        params = {"poses": pose[None], "Rh": Rh[k : k + 1], "Th": Th[k : k + 1],
                  "shapes": np.zeros((1, 10))}  # fmt: skip
        (source / "new_params").mkdir(exist_ok=True)
        np.save(source / f"new_params/{k + 7}.npy", params)
    lens = K - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])  # OpenCV's
    sheared = matrices(TURN) + 1e-4  # digits were lost
    cams = {"K": [np.eye(3), lens], "D": [np.zeros((5, 1))] * 2, "R": [np.eye(3), sheared],
            "T": [np.zeros((3, 1)), 1000 * MOVE[:, None]]}  # fmt: skip
    annots = {"cams": cams, "ims": [{"ims": pair} for pair in names]}
    np.save(source / "annots.npy", annots)
    folder, said = prepared(source, "--camera", "1")
    assert "zju, SMPL" in said and "camera 1 of 2; --camera takes another" in said
    rotations, places = seen
    video = load_video(folder)
    assert np.array_equal(video[2].mask > 0.5, MASK > 0)
    assert np.abs(video.cameras[0].K - K).max() < 1e-6
    R = matrices(video.pose.rotations)[:, 0]
    assert np.abs(np.diag([1, -1, -1]) @ R - matrices(rotations)[:, 0]).max() < 1e-3
    code, _, err = cli("prepare", "zju", source, tmp_path / "b", *PUPPET, "--camera", "7")
    assert code == 2 and "has no camera '7'; it has 0, 1" in err
    annots["ims"][0]["ims"][1] = "../../secret.jpg"
    np.save(source / "annots.npy", annots)
    code, _, err = cli("prepare", "zju", source, tmp_path / "b", *PUPPET, "--camera", "1")
    assert code == 2 and "'../../secret.jpg', which is outside of the folder" in err


OTHER_TURN, OTHER_MOVE = np.array([-0.2, 1.1, 0.3]), np.array([-0.4, 0.2, 1.0])
OTHER_K = np.array([[90.0, 0, 30], [0, 95, 27], [0, 0, 1]])


@pytest.fixture
def two_cameras(tmp_path, thetas, world):
    """ZJU-MoCap: camera 0 is the video's, camera 1 sees the same from another side."""
    source = tmp_path / "CoreView"
    Rh, Th = about_origin(thetas, world)
    ims = []
    for k, shot in enumerate(shots()):
        ims.append({"ims": [f"Camera_B{c}/{k:06d}.jpg" for c in (1, 2)]})
        for c in (1, 2):
            write_image(source / ims[-1]["ims"][c - 1], shot // c)
            mask = MASK // 255 * (MASK * 0 + 3)
            write_image(source / f"mask/Camera_B{c}/{k:06d}.png", np.roll(mask, 4 * c * (k > 0), 1))
        params = {"poses": np.concatenate([np.zeros(3), thetas[k, 3:]])[None], "Rh": Rh[k : k + 1],
                  "Th": Th[k : k + 1], "shapes": np.zeros((1, 10))}  # fmt: skip
        (source / "params").mkdir(exist_ok=True)
        np.save(source / f"params/{k}.npy", params)
    half = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    cams = {"K": [K - half, OTHER_K - half], "D": [np.zeros(5)] * 2,
            "R": [matrices(TURN), matrices(OTHER_TURN)],
            "T": [1000 * MOVE[:, None], 1000 * OTHER_MOVE[:, None]]}  # fmt: skip
    np.save(source / "annots.npy", {"cams": cams, "ims": ims})
    return source


def test_other_cameras_see_the_person_where_they_are(two_cameras, world, prepared):
    folder, said = prepared(two_cameras, "--views", "1", "--view-frames", 3)
    assert "3 views held out, of cameras 1" in said
    video = load_video(folder)
    held = held_out_views(video)
    about = json.loads((folder / "views/views.json").read_text())
    assert about == {"frames": [0, 2, 4], "cameras": ["1"] * 3}
    with torch.no_grad():
        place = load_body()(held.pose, held.shape).joints[:, 0].double().numpy()
    there = world[1][[0, 2, 4]] @ matrices(OTHER_TURN).T + OTHER_MOVE
    wanted = there @ OTHER_K.T
    for k, camera in enumerate(held.cameras):
        assert np.abs(camera.project(place[k]) - wanted[k, :2] / wanted[k, 2]).max() < 1e-3
        assert abs((camera.T_camera_world @ np.append(place[k], 1))[2] - there[k, 2]) < 1e-5
    assert np.array_equal(held[1].mask > 0.5, np.roll(MASK, 8, 1) > 0)
    assert np.array_equal(read_image(folder / "views/frames/000001.png", 3).shape, (48, 64, 3))


def test_views_that_are_not_there(two_cameras, tmp_path, cli):
    def refused(words, *more):
        code, _, err = cli("prepare", "zju", two_cameras, tmp_path / "b", *PUPPET, *more)
        assert code == 2 and words in err and err.count("\n") <= 2, err
        assert not (tmp_path / "b").exists()

    refused("has no other camera '0' to hold out; it has 1", "--views", "0")
    code, _, err = cli("prepare", "auto", two_cameras, tmp_path / "b", *PUPPET, "--views", "7")
    assert code == 2 and "100%" not in err and "camera '7'" in err  # before anything is written
    refused(
        "--view-frames must be a whole number from 1 to 100,000, got 0",
        "--views",
        "all",
        "--view-frames",
        0,
    )
    for path in (two_cameras / "mask/Camera_B2").iterdir():
        path.unlink()
    refused("other cameras have no picture and mask of the video", "--views", "all")


def yaml(path, **matrices_):
    text = '%YAML:1.0\r\n---\r\nnames:\r\n  - "2"\r\n  - "1"\r\n'
    for name, x in matrices_.items():
        x = np.atleast_2d(x)
        text += f"{name}: !!opencv-matrix\r\n  rows: {x.shape[0]}\r\n  cols: {x.shape[1]}\r\n"
        text += f"  dt: d\r\n  data: [{', '.join(f'{v:.9f}' for v in x.ravel())}]\r\n"
    path.write_text(text)


@pytest.mark.parametrize("form", ["list", "annots"])
def test_easymocap(tmp_path, seen, thetas, world, prepared, stands, form):
    source = tmp_path / "scene"
    Rh, Th = about_origin(thetas, world)
    lens = K - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    for k, shot in enumerate(shots()):
        write_image(source / f"images/1/{k:06d}.jpg", shot)
        write_image(source / f"mask/1/{k:06d}.png", MASK)
        poses = thetas[k, 3:] if form == "annots" else np.concatenate([np.zeros(3), thetas[k, 3:]])
        person = {"id": 4, "Rh": [Rh[k].tolist()], "Th": [Th[k].tolist()],
                  "poses": [poses.tolist()], "shapes": [[0.0] * 10]}  # fmt: skip
        file = source / f"output-smpl-3d/smpl/{k:06d}.json"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps([person] if form == "list" else {"annots": [person]}))
    yaml(source / "intri.yml", K_1=lens, dist_1=np.zeros(5), K_2=np.eye(3), dist_2=np.zeros(5))
    yaml(source / "extri.yml", R_1=TURN[:, None], Rot_1=matrices(TURN), T_1=MOVE[:, None])
    folder, said = prepared(source, "--camera", "1", "--person", "4")
    assert "easymocap, SMPL" in said
    stands(folder, *seen, K)


@pytest.mark.parametrize("form", ["87", "165", "78", "156", "66 and hands"])
def test_easymocap_with_hands(tmp_path, seen, thetas, world, cli, stands, form):
    """SMPL-X and SMPL+H, joint by joint or by six components a hand."""
    source, rotations = tmp_path / "scene", seen[0].copy()
    random = np.random.default_rng(0)
    with np.load(PUPPET_FILE) as file:
        body = dict(file)
    np.savez(tmp_path / "body.npz", **body)
    is_x = form in ("87", "165")
    pelvis = SMPLX if is_x else SMPL
    Rh, Th = thetas[:, :3], world[1] - np.einsum("nij,j->ni", matrices(thetas[:, :3]), pelvis)
    codes = random.normal(0, 0.3, (FRAMES, 2, 6))
    if form not in ("156", "165"):
        fingers = [codes[:, i] @ body[f"hands_components{s}"][:6] for i, s in enumerate("lr")]
        rotations[:, 25:] = np.concatenate(fingers, axis=1).reshape(FRAMES, 30, 3)
    if form == "66 and hands":  # relative to the mean hand
        mean = np.concatenate([body["hands_meanl"], body["hands_meanr"]])
        rotations[:, 25:] += mean.reshape(30, 3)
    if not is_x:
        rotations[:, 22:25] = 0
    lens = K - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    for k, shot in enumerate(shots()):
        write_image(source / f"images/1/{k:06d}.jpg", shot)
        write_image(source / f"mask/1/{k:06d}.png", MASK)
        limbs = [np.zeros(3), rotations[k, 1:22].ravel()]
        face, hands = rotations[k, 22:25].ravel(), rotations[k, 25:].ravel()
        more = {}
        if form in ("87", "78"):
            limbs += [codes[k].ravel()] + ([face] if is_x else [])
        elif form in ("165", "156"):
            limbs += ([face] if is_x else []) + [hands]
        else:
            more = {"handl": [codes[k, 0].tolist()], "handr": [codes[k, 1].tolist()]}
        person = {"id": 0, "Rh": [Rh[k].tolist()], "Th": [Th[k].tolist()], "shapes": [[0.0] * 10],
                  "poses": [np.concatenate(limbs).tolist()]} | more  # fmt: skip
        file = source / f"output/smplx/smpl/{k:06d}.json"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps([person]))
    yaml(source / "intri.yml", K_1=lens, dist_1=np.zeros(5))
    yaml(source / "extri.yml", Rot_1=matrices(TURN), T_1=MOVE[:, None])
    given = ("prepare", "auto", source, tmp_path / "s", "--body", tmp_path / "body.npz")
    code, said, err = cli(*given)
    assert code == 0, err
    assert f"easymocap, {'SMPL-X' if is_x else 'SMPL+H'}, 5 frames" in said
    stands(tmp_path / "s", rotations, seen[1], K, joints=55)
    if form == "87":
        file.write_text(json.dumps([person | {"poses": [[0.0] * 70]}]))
        for path in file.parent.iterdir():
            path.write_text(file.read_text())
        code, _, err = cli("prepare", "auto", source, tmp_path / "b", *given[4:])
        assert code == 2 and "'poses' has 70 numbers a frame; expected SMPL's 72 or 69" in err


def test_views_of_cameras_with_files_of_their_own(tmp_path, thetas, world, prepared):
    """EasyMocap; one camera's pictures are larger than those of the first that is held out."""
    source = tmp_path / "scene"
    Rh, Th = about_origin(thetas, world)
    half = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    for k, shot in enumerate(shots()):
        for camera in ("1", "2", "3"):
            shown = np.pad(shot, ((0, 2), (0, 0), (0, 0))) if camera == "3" else shot
            mask = np.pad(MASK, ((0, 2), (0, 0))) if camera == "3" else MASK
            if (camera, k) != ("2", 4):
                write_image(source / f"images/{camera}/{k:06d}.jpg", shown)
                write_image(source / f"mask/{camera}/{k:06d}.png", mask)
        person = {"id": 0, "Rh": [Rh[k].tolist()], "Th": [Th[k].tolist()], "shapes": [[0.0] * 10],
                  "poses": [np.append(np.zeros(3), thetas[k, 3:]).tolist()]}  # fmt: skip
        file = source / f"smpl/{k:06d}.json"
        file.parent.mkdir(exist_ok=True)
        file.write_text(json.dumps([person]))
    yaml(source / "intri.yml", K_1=K - half, K_2=OTHER_K - half, K_3=K - half)
    yaml(source / "extri.yml", Rot_1=matrices(TURN), T_1=MOVE[:, None], T_3=MOVE[:, None],
         R_2=OTHER_TURN[:, None], T_2=OTHER_MOVE[:, None], Rot_3=matrices(TURN))  # fmt: skip
    folder, said = prepared(source, "--views", "all", "--view-frames", 2)
    assert "2 views held out, of cameras 2" in said
    assert "left out, of another size of pictures: cameras 3" in said
    held = held_out_views(load_video(folder))
    assert json.loads((folder / "views/views.json").read_text())["frames"] == [0, 3]
    with torch.no_grad():
        place = load_body()(held.pose, held.shape).joints[:, 0].double().numpy()
    wanted = (world[1][[0, 3]] @ matrices(OTHER_TURN).T + OTHER_MOVE) @ OTHER_K.T
    for k, camera in enumerate(held.cameras):
        assert np.abs(camera.project(place[k]) - wanted[k, :2] / wanted[k, 2]).max() < 1e-3


def test_avatarrex(tmp_path, seen, world, prepared, stands):
    """A picture that was lost is left out, with its pose."""
    source = tmp_path / "avatarrex_zzr"
    rotations, places = seen
    lens = K - np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    for k, shot in enumerate(shots()):
        if k != 2:
            write_image(source / f"22010708/{k:08d}.jpg", shot)
            write_image(source / f"22010708/mask/pha/{k:08d}.jpg", MASK)
    camera = {"K": lens.ravel().tolist(), "R": matrices(TURN).ravel().tolist(), "T": MOVE.tolist(),
              "imgSize": [WIDTH, HEIGHT]}  # fmt: skip
    (source / "calibration_full.json").write_text(json.dumps({"22010708": camera}))
    flat = lambda part: rotations[:, part].reshape(FRAMES, -1)
    np.savez(
        source / "smpl_params.npz", betas=np.zeros((1, 10)), global_orient=world[0],
        transl=world[1] - SMPLX, body_pose=flat(slice(1, 22)), jaw_pose=flat(slice(22, 23)),
        left_hand_pose=flat(slice(25, 40)), right_hand_pose=flat(slice(40, 55)),
        expression=np.zeros((FRAMES, 10)),
    )  # fmt: skip
    folder, said = prepared(source)
    assert "avatarrex, SMPL-X, 4 frames" in said
    kept = [0, 1, 3, 4]
    stands(folder, rotations[kept], places[kept], K, joints=23)


def test_what_is_no_data_set_needs_pictures(tmp_path, cli):
    (tmp_path / "x").mkdir()
    assert dataset_of(tmp_path / "x") is None
    code, _, err = cli("prepare", "auto", tmp_path / "x", tmp_path / "s", *PUPPET)
    assert code == 2 and "brings no frames of its own; give --frames" in err
    code, _, err = cli("prepare", "zju", tmp_path / "x", tmp_path / "s", *PUPPET)
    assert code == 2 and "not of the kind zju; expected a folder with annots.npy" in err


def test_neuman(tmp_path, seen, thetas, world, prepared, stands, cli):
    """A body that its alignment scales is seen as one that is nearer, and is not scaled."""
    source, names = tmp_path / "bike", [f"{k:05d}.png" for k in range(FRAMES)]
    rotations, places = seen
    scale = np.array([1.0, 1.5, 2.0, 0.5, 1.25])
    quat = roma.rotmat_to_unitquat(torch.from_numpy(matrices(TURN))).numpy()[[3, 0, 1, 2]]
    images, alignments = ["# Image list", "#   IMAGE_ID, QW, ..."], {}
    for k, (name, shot) in enumerate(zip(names, shots(), strict=True)):
        write_image(source / "images" / name, shot)
        write_image(source / "segmentations" / name, 255 - MASK)
        # The body stands at the origin; the alignment turns nothing, and the root has its turn.
        transf = np.zeros((4, 3))
        transf[:3] = scale[k] * np.eye(3)
        camera = scale[k] * (places[k] - matrices(TURN) @ SMPL) - MOVE  # x_c = R x + MOVE
        transf[3] = matrices(TURN).T @ camera
        alignments[name] = transf
        numbers = " ".join(f"{x:.12f}" for x in (*quat, *MOVE))
        images += [f"{FRAMES - k} {numbers} 1 {name}", "1.0 2.0 -1"]
    (source / "sparse").mkdir()
    (source / "sparse/images.txt").write_text("\n".join(images))
    lens = f"1 PINHOLE {WIDTH} {HEIGHT} {K[0, 0]} {K[1, 1]} {K[0, 2]} {K[1, 2]}"
    (source / "sparse/cameras.txt").write_text(f"# Camera list\n{lens}\n")
    np.save(source / "alignments.npy", alignments)
    for name, poses in (("romp", 0 * thetas), ("optimized", list(thetas[:, None]))):
        found = {1: {"pose": poses, "betas": np.zeros((FRAMES, 10))}}
        (source / f"smpl_output_{name}.pkl").write_bytes(pickle.dumps(found))
    (source / "train_split.txt").write_text("00000.png\n00001.png\n00004.png\n")
    (source / "test_split.txt").write_text("00002.png\n")
    folder, said = prepared(source)
    assert "neuman, SMPL" in said
    video = stands(folder, rotations, places, K)
    assert np.array_equal(video[2].mask > 0.5, MASK > 0)
    assert (video.splits.train, video.splits.test) == ([0, 1, 4], [2])
    (source / "sparse/cameras.txt").write_text(lens.replace("PINHOLE", "FOV"))
    code, _, err = cli("prepare", "auto", source, tmp_path / "b", *PUPPET)
    assert code == 2 and "a lens FOV; expected one of PINHOLE" in err
