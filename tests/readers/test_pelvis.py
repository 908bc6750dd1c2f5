"""A body turns about the pelvis of its own betas: vertices stand where the source has them."""

import json

import numpy as np
import pytest
import roma
import torch
from samples.data_sets import SMPLX as MEAN
from samples.estimates import without_hands

from gva_mi.body.pose import Pose, Shape, save_poses
from gva_mi.body.smplx import load_body
from gva_mi.subject.fingerprint import fingerprint
from gva_mi.subject.pictures import write_image
from gva_mi.subject.video import load_video

GROWS = np.array([0.4, 0.04, -0.02])  # metres a beta moves it
ROOT, MOVE, BETAS = np.array([3.0, 0.1, 0.2]), np.array([0.1, 0.2, 3.0]), np.array([2.0] + [0] * 9)
K = np.array([[80.0, 0, 24], [0, 80, 32], [0, 0, 1]])


@pytest.fixture(scope="module")
def smplx(tmp_path_factory):
    """A body's file with SMPL-X's mean pelvis, whose first beta makes it larger and moves it."""
    path = tmp_path_factory.mktemp("body") / "SMPLX_X.npz"
    arrays = load_body(None, torch.float64).arrays()
    places = arrays["v_template"] - arrays["J_regressor"][0] @ arrays["v_template"] + MEAN
    directions = np.zeros((len(places), 3, 20))
    directions[..., 0] = 0.04 * places + GROWS
    directions[:50, 1, 10] = 1e-3  # an expression
    np.savez(path, **{**arrays, "v_template": places, "shapedirs": directions})
    return path


@pytest.fixture
def shot(tmp_path):
    mask = np.zeros((64, 48), "u1")
    mask[10:50, 15:35] = 255
    write_image(tmp_path / "f/0.png", np.repeat(mask[..., None], 3, 2))
    write_image(tmp_path / "m/0.png", mask)
    return "--frames", tmp_path / "f", "--masks", tmp_path / "m"


def turned(points, pelvis, place):
    """R (x − p) and the pelvis's place."""
    R = roma.rotvec_to_rotmat(torch.tensor(ROOT)).numpy()
    return (points - pelvis) @ R.T + place


def parameters(folder):
    np.savez(folder / "p.npz", global_orient=ROOT[None], body_pose=np.zeros((1, 63)), K=K,
             transl=MOVE[None], betas=BETAS)  # fmt: skip
    return "parameters", folder / "p.npz"


def gvhmr(folder):
    person = {"global_orient": ROOT[None], "body_pose": np.zeros((1, 63)), "transl": MOVE[None],
              "betas": BETAS[None]}  # fmt: skip
    person = {name: torch.tensor(x, dtype=torch.float32) for name, x in person.items()}
    found = {"smpl_params_global": person, "smpl_params_incam": person,
             "K_fullimg": torch.tensor(K)[None].float()}  # fmt: skip
    torch.save(found, folder / "hmr4d_results.pt")
    return "gvhmr", folder / "hmr4d_results.pt"


def smplerx(folder):
    return "smplerx", without_hands(folder, K[None], ROOT[None], MOVE[None], BETAS)


@pytest.mark.parametrize("write", [parameters, gvhmr, smplerx])
@pytest.mark.parametrize("lens", [None, 160])
def test_estimators(write, lens, tmp_path, cli, smplx, shot):
    """x = R (b − p(β)) + p(β) + t; before a lens twice as long the pelvis is twice as far away."""
    (tmp_path / "source").mkdir()
    kind, source = write(tmp_path / "source")
    given = [] if lens is None else ["--lens", lens]
    said = cli.works("prepare", kind, source, tmp_path / "s", "--body", smplx, *shot, *given)
    assert "place and betas are the source's own" in said
    arrays = np.load(smplx)
    points = arrays["v_template"] + 2 * arrays["shapedirs"][..., 0]
    pelvis = arrays["J_regressor"][0] @ points
    assert np.abs(pelvis - MEAN).max() > 0.5
    video = load_video(tmp_path / "s")
    T = video.cameras[0].T_camera_world
    with torch.no_grad():
        posed = load_body(smplx, torch.float64)(video.pose.to(torch.float64),
                                                Shape(video.shape.betas.double()))  # fmt: skip
    camera = lambda x: x[0].numpy() @ T[:3, :3].T + T[:3, 3]
    if lens is None:
        assert np.abs(camera(posed.vertices) - turned(points, pelvis, pelvis + MOVE)).max() < 1e-5
    place = (pelvis + MOVE) * ([1, 1, 1] if lens is None else [1, 1, 2])
    assert np.abs(camera(posed.joints)[0] - place).max() < 1e-5


def test_another_body_is_told_that_the_pelvis_is_the_mean_persons(tmp_path, cli, shot):
    kind, source = parameters(tmp_path)
    said = cli.works("prepare", kind, source, tmp_path / "s", "--body", "built-in", *shot)
    assert "betas of SMPL-X do not carry over" in said
    assert "the pelvis is the mean person's, because the source's SMPL-X body is not given" in said
    np.savez(source, **{**np.load(source), "betas": np.zeros(10)})
    said = cli.works("prepare", kind, source, tmp_path / "b", "--body", "built-in", *shot)
    assert "the mean person's" not in said


def test_a_folders_own_body_keeps_betas_and_face(tmp_path, cli, shot):
    """Poses of a subject that was made on this very body, known by its fingerprint."""
    folder, face = tmp_path / "subject", torch.linspace(-1, 1, 10)
    pose = Pose(torch.zeros(1, 55, 3), torch.tensor([[0.0, 0, 3]]), face[None])
    save_poses(folder / "poses.npz", pose, Shape(face.flip(0)), stage=1)
    given = ("prepare", "parameters", folder / "poses.npz", tmp_path / "s", "--body", "built-in",
             *shot, "--lens", 80)  # fmt: skip
    for about, kept in ((None, False), ({"body": fingerprint(load_body())}, True)):
        if about:
            (folder / "synth.json").write_text(json.dumps(about))
        said = cli.works(*given, "--overwrite")
        assert ("do not carry over" in said) != kept
        found = load_video(tmp_path / "s")
        for x, wanted in ((found.shape.betas, face.flip(0)), (found.pose.expression[0], face)):
            assert torch.allclose(x, wanted if kept else torch.zeros(10), atol=1e-6)


@pytest.mark.parametrize(("root", "place", "doubtful"),
    [(np.pi, (0.0, 0.2, 2.9), False), (np.pi, (1.0, 0.2, 2.9), True), (0, (0.0, 0.2, 2.9), True)],
    ids=["in the masks", "another place", "on the head, as in a world with y up"])  # fmt: skip
def test_poses_that_are_not_where_the_masks_are_raise_a_doubt(tmp_path, cli, root, place, doubtful):
    mask = np.zeros((240, 160), np.uint8)
    mask[30:210, 60:100] = 255
    write_image(tmp_path / "f/0.png", np.repeat(mask[..., None], 3, 2))
    write_image(tmp_path / "m/0.png", mask)
    poses = np.zeros((1, 72))
    poses[0, 0] = root
    np.savez(tmp_path / "p.npz", poses=poses, trans=[place], betas=np.zeros(10))
    shot = ("--frames", tmp_path / "f", "--masks", tmp_path / "m", "--lens", 290)
    given = (tmp_path / "p.npz", tmp_path / "s", "--body", "built-in", *shot)
    said = cli.works("prepare", "auto", *given)
    assert ("doubtful: " in said) == doubtful
