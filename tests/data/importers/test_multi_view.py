"""Data sets of many cameras: one is the video, and others hold out views of the same moments."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest
import torch

from gva_mi.body.built_in import BUILT_IN_BODY as PUPPET_FILE
from gva_mi.body.smplx import load_body
from gva_mi.data.pictures import read_image, write_image
from gva_mi.data.video import load_video
from gva_mi.data.views import held_out_views

spec = importlib.util.spec_from_file_location("filmed", Path(__file__).with_name("filmed.py"))
filmed = importlib.util.module_from_spec(spec)
spec.loader.exec_module(filmed)

WIDTH, HEIGHT, FRAMES = filmed.WIDTH, filmed.HEIGHT, filmed.FRAMES
K, TURN, MOVE, MASK, BUILT_IN_BODY = (
    filmed.K,
    filmed.TURN,
    filmed.MOVE,
    filmed.MASK,
    filmed.BUILT_IN_BODY,
)
SMPL, SMPLX, matrices, shots = filmed.SMPL, filmed.SMPLX, filmed.matrices, filmed.shots


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
    code, _, err = cli("prepare", "zju", source, tmp_path / "b", *BUILT_IN_BODY, "--camera", "7")
    assert code == 2 and "has no camera '7'; it has 0, 1" in err
    annots["ims"][0]["ims"][1] = "../../secret.jpg"
    np.save(source / "annots.npy", annots)
    code, _, err = cli("prepare", "zju", source, tmp_path / "b", *BUILT_IN_BODY, "--camera", "1")
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


def test_missing_views_are_refused(two_cameras, tmp_path, cli):
    def refused(words, *more):
        code, _, err = cli("prepare", "zju", two_cameras, tmp_path / "b", *BUILT_IN_BODY, *more)
        assert code == 2 and words in err and err.count("\n") <= 2, err
        assert not (tmp_path / "b").exists()

    refused("has no other camera '0' to hold out; it has 1", "--views", "0")
    code, _, err = cli(
        "prepare", "auto", two_cameras, tmp_path / "b", *BUILT_IN_BODY, "--views", "7"
    )
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


def test_views_of_cameras_of_different_sizes(tmp_path, thetas, world, prepared):
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
