"""Data sets of many cameras: one is the video, and others hold out views of the same moments."""

import json

import numpy as np
import pytest
import torch
from samples import data_sets as filmed

from gva_mi.body.smplx import load_body
from gva_mi.data.ground_truth import held_out_views
from gva_mi.data.pictures import write_image
from gva_mi.data.video import load_video


@pytest.mark.parametrize("stem", ["{:06d}", "CoreView_313_Camera_(2)_{:04d}_2019"])
def test_zju_mocap(tmp_path, seen, thetas, world, prepared, stands, cli, stem):
    source = filmed.zju(tmp_path / "CoreView", thetas, world[1], stem=stem, first=7, cameras=(2, 1))
    folder, said = prepared(source, "--camera", "1")
    assert "zju, SMPL" in said and "camera 1 of 2; --camera takes another" in said
    video = stands(folder, *seen, filmed.K)
    assert np.array_equal(video[2].mask > 0.5, filmed.MASK > 0)
    refused = lambda name: cli(
        "prepare", "zju", source, tmp_path / "b", *filmed.BUILT_IN_BODY, "--camera", name
    )
    code, _, err = refused("7")
    assert code == 2 and "has no camera '7'; it has 0, 1" in err
    annots = np.load(source / "annots.npy", allow_pickle=True).item()
    annots["ims"][0]["ims"][1] = "../../secret.jpg"
    np.save(source / "annots.npy", annots)
    code, _, err = refused("1")
    assert code == 2 and "'../../secret.jpg', which is outside of the folder" in err


@pytest.fixture
def two_cameras(tmp_path, thetas, world):
    return filmed.zju(tmp_path / "CoreView", thetas, world[1], cameras=(1, 2))


def sees(held, pelvises):
    """Held-out cameras project and place the person's pelvis where the second camera sees it."""
    with torch.no_grad():
        place = load_body()(held.pose, held.shape).joints[:, 0].double().numpy()
    there = pelvises @ filmed.matrices(filmed.OTHER_TURN).T + filmed.OTHER_MOVE
    wanted = there @ filmed.OTHER_K.T
    for k, camera in enumerate(held.cameras):
        assert np.abs(camera.project(place[k]) - wanted[k, :2] / wanted[k, 2]).max() < 1e-3
        assert abs((camera.T_camera_world @ np.append(place[k], 1))[2] - there[k, 2]) < 1e-5


def test_other_cameras_see_the_person_where_they_are(two_cameras, world, prepared):
    folder, said = prepared(two_cameras, "--views", "1", "--view-frames", 3)
    assert "3 views held out, of cameras 1" in said
    held = held_out_views(load_video(folder))
    about = json.loads((folder / "views/views.json").read_text())
    assert about == {"frames": [0, 2, 4], "cameras": ["1"] * 3}
    sees(held, world[1][[0, 2, 4]])
    assert np.array_equal(held[1].mask > 0.5, np.roll(filmed.MASK, 8, 1) > 0)


def test_missing_views_are_refused(two_cameras, tmp_path, cli):
    def refused(words, *more):
        given = ("zju", two_cameras, tmp_path / "b", *filmed.BUILT_IN_BODY)
        err = cli.fails("prepare", *given, "--views", *more)
        assert words in err and err.count("\n") <= 2, err
        assert not (tmp_path / "b").exists()

    refused("has no other camera '0' to hold out; it has 1", "0")
    refused("--view-frames must be a whole number from 1", "all", "--view-frames", 0)
    for path in (two_cameras / "mask/Camera_B2").iterdir():
        path.unlink()
    refused("other cameras have no picture and mask of the video", "all")


@pytest.mark.parametrize("form", ["list", "annots"])
def test_easymocap(tmp_path, seen, thetas, world, prepared, stands, form):
    """A list of people, or one under ``annots`` with poses without the root."""
    poses = thetas[:, 3:] if form == "annots" else thetas * (np.arange(72) > 2)
    people = (*filmed.about_origin(thetas, world[1]), poses)
    wrap = lambda person: [person] if form == "list" else {"annots": [person]}
    source = filmed.easymocap(tmp_path / "scene", people, under="output-smpl-3d/smpl", wrap=wrap)
    folder, said = prepared(source, "--camera", "1", "--person", "4")
    assert "easymocap, SMPL" in said
    stands(folder, *seen, filmed.K)


@pytest.mark.parametrize("form", ["SMPL-X", "SMPL+H"])
def test_easymocap_with_hands(tmp_path, seen, thetas, world, prepared, cli, stands, form):
    rotations = seen[0].copy()
    if form == "SMPL+H":
        rotations[:, 22:25] = 0
    joints = slice(0, 55) if form == "SMPL-X" else [*range(22), *range(25, 55)]
    poses = rotations[:, joints].reshape(filmed.FRAMES, -1).copy()
    poses[:, :3] = 0
    pelvis = filmed.SMPLX if form == "SMPL-X" else filmed.SMPL
    people = (*filmed.about_origin(thetas, world[1], pelvis), poses)
    folder, said = prepared(filmed.easymocap(tmp_path / "scene", people))
    assert f"easymocap, {form}, 5 frames" in said
    stands(folder, rotations, seen[1], filmed.K, joints=55)
    pca = filmed.easymocap(tmp_path / "pca", (*people[:2], poses[:, :78]))
    err = cli.fails("prepare", "auto", pca, tmp_path / "b", *filmed.BUILT_IN_BODY)
    assert "'poses' has 78 numbers a frame; expected axis-angle, 165" in err


def test_views_of_cameras_of_different_sizes(tmp_path, thetas, world, prepared):
    """EasyMocap; one camera's pictures are larger than those of the first that is held out."""
    people = (*filmed.about_origin(thetas, world[1]), thetas * (np.arange(72) > 2))
    source = filmed.easymocap(tmp_path / "scene", people)
    for k, shot in enumerate(filmed.shots()):
        for camera, below in (("2", 0), ("3", 2)):
            if (camera, k) != ("2", 4):
                pad = ((0, below), (0, 0))
                write_image(source / f"images/{camera}/{k:06d}.jpg", np.pad(shot, (*pad, (0, 0))))
                write_image(source / f"mask/{camera}/{k:06d}.png", np.pad(filmed.MASK, pad))
    K, R, T = filmed.K - filmed.HALF, filmed.matrices(filmed.TURN), filmed.MOVE[:, None]
    filmed.yaml(source / "intri.yml", K_1=K, K_2=filmed.OTHER_K - filmed.HALF, K_3=K)
    filmed.yaml(source / "extri.yml", Rot_1=R, T_1=T, T_3=T, R_2=filmed.OTHER_TURN[:, None],
                T_2=filmed.OTHER_MOVE[:, None], Rot_3=R)  # fmt: skip
    folder, said = prepared(source, "--views", "all", "--view-frames", 2)
    assert "2 views held out, of cameras 2" in said
    assert "left out, of another size of pictures: cameras 3" in said
    assert json.loads((folder / "views/views.json").read_text())["frames"] == [0, 3]
    sees(held_out_views(load_video(folder)), world[1][[0, 3]])


def test_avatarrex(tmp_path, seen, world, prepared, stands):
    """A picture that was lost is left out, with its pose."""
    source = filmed.avatarrex(tmp_path / "avatarrex_zzr", seen[0], *world, lost=(2,))
    folder, said = prepared(source)
    assert "avatarrex, SMPL-X, 4 frames" in said
    kept = [0, 1, 3, 4]
    stands(folder, seen[0][kept], seen[1][kept], filmed.K, joints=23)
