"""Data sets of many cameras: one is the video, and others hold out views of the same moments."""

import json

import numpy as np
import pytest
import torch
from samples import data_sets as filmed

from gva_mi.body.smplx import load_body
from gva_mi.subject.ground_truth import held_out_views
from gva_mi.subject.video import load_video


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
    folder, said = prepared(two_cameras, "--views", "1")
    assert "5 views held out, of cameras 1" in said
    held = held_out_views(load_video(folder))
    about = json.loads((folder / "views/views.json").read_text())
    assert about == {"frames": [0, 1, 2, 3, 4], "cameras": ["1"] * 5}
    sees(held, world[1])
    assert np.array_equal(held[1].mask > 0.5, np.roll(filmed.MASK, 8, 1) > 0)


def test_missing_views_are_refused(two_cameras, tmp_path, cli):
    given = ("prepare", "zju", two_cameras, tmp_path / "b", *filmed.BUILT_IN_BODY, "--views")
    assert "has no other camera '0' to hold out; it has 1" in cli.fails(*given, "0")
    for path in (two_cameras / "mask/Camera_B2").iterdir():
        path.unlink()
    assert "other cameras have no picture and mask of the video" in cli.fails(*given, "all")
    assert not (tmp_path / "b").exists()
