"""A motion that is known: somebody who walks, in a world with y up; and how a camera sees it."""

import pickle

import numpy as np
import pytest
import torch
from samples import data_sets as filmed
from samples.data_sets import FRAMES, HEIGHT, WIDTH
from samples.estimates import of_smpl

from gva_mi.body.rotations import composed, to_matrices
from gva_mi.body.smplx import load_body
from gva_mi.subject.pictures import write_image
from gva_mi.subject.video import load_video


@pytest.fixture(scope="session")
def walk():
    """Rotations (T, 55, 3) and translations (T, 3) of so many frames."""

    def motion(frames):
        random = np.random.default_rng(1)
        t = np.arange(frames)[:, None, None] / 30
        rotations = 0.3 * np.sin(2 * t + 6 * random.random((1, 55, 1))) * random.random((1, 55, 3))
        rotations[:, 0] = 0
        rotations[:, 0, 1] = 0.4 * t[:, 0, 0]
        transl = np.concatenate([t[:, 0] * 0.5, 0 * t[:, 0], t[:, 0] * 0.2], axis=1)
        return rotations, transl

    return motion


@pytest.fixture
def seen(walk):
    """A person before the camera, in its axes: upright there is half a turn about x."""
    rotations, _ = walk(FRAMES)
    rotations[:, 0] = composed([np.pi, 0, 0], rotations[:, 0])
    return rotations, np.tile([0.1, -0.3, 4.0], (FRAMES, 1))


@pytest.fixture
def world(seen):
    """In a world that TURN and MOVE take to the camera: roots (T, 3) and pelvises (T, 3)."""
    rotations, places = seen
    R = filmed.matrices(filmed.TURN)
    return filmed.vectors(R.T @ filmed.matrices(rotations[:, 0])), (places - filmed.MOVE) @ R


@pytest.fixture
def thetas(seen, world):
    """SMPL's poses in that world (T, 72)."""
    body = np.concatenate([seen[0][:, 1:22], np.ones((FRAMES, 2, 3))], axis=1)
    return np.concatenate([world[0], body.reshape(FRAMES, 69)], axis=1)


@pytest.fixture
def prepared(tmp_path, cli):
    """Prepare a data set for the built-in body: the subject's folder, and what was said."""

    def run(source, *more, kind="auto"):
        said = cli.works("prepare", kind, source, tmp_path / "s", *filmed.BUILT_IN_BODY, *more)
        return tmp_path / "s", said

    return run


@pytest.fixture
def wham(tmp_path):
    """Write WHAM's file of people _0, _1, ...: rotations, translations, and frame numbers."""

    def write(**people):
        found = {}
        for name, (rotations, transl, *frames) in people.items():
            pose = of_smpl(rotations).reshape(-1, 72)
            found[np.int64(name[1:])] = {
                "pose": pose, "trans": transl, "betas": np.zeros((len(pose), 10)),
                "frame_ids": np.array(frames[0]) if frames else np.arange(len(pose)),
            }  # fmt: skip
        (tmp_path / "wham_output.pkl").write_bytes(pickle.dumps(found))
        return tmp_path / "wham_output.pkl"

    return write


@pytest.fixture
def footage(tmp_path):
    """Pictures as a folder numbered by people, and masks as an array."""
    random = np.random.default_rng(0)
    for k in range(FRAMES):
        image = random.integers(0, 255, (HEIGHT, WIDTH, 3), dtype=np.uint8)
        write_image(tmp_path / f"shots/frame_{k + 8}.png", image)
    mask = np.zeros((FRAMES, HEIGHT, WIDTH), bool)
    mask[:, 10:40, 20:40] = True
    np.save(tmp_path / "masks.npy", mask)
    return ["--body", "built-in", "--frames", tmp_path / "shots", "--masks", tmp_path / "masks.npy"]


@pytest.fixture
def stands():
    """That a folder opens, and its person stands and turns where the source says."""

    def check(folder, rotations, places, K, joints=22):
        """Pelvises (n, 3) in the camera's axes; K (3, 3) or (n, 3, 3)."""
        video = load_video(folder)
        n = len(rotations)
        assert len(video) == n
        found, wanted = to_matrices(video.pose.rotations.numpy()), to_matrices(rotations)
        assert np.abs(found[:, 0] - np.diag([1.0, -1.0, -1.0]) @ wanted[:, 0]).max() < 1e-5
        assert np.abs(found[:, 1:joints] - wanted[:, 1:joints]).max() < 1e-5
        with torch.no_grad():
            place = load_body()(video.pose, video.shape).joints[:, 0].double().numpy()
        K = np.broadcast_to(K, (n, 3, 3))
        for k, camera in enumerate(video.cameras):
            x = K[k] @ places[k]
            assert np.abs(camera.project(place[k]) - x[:2] / x[2]).max() < 2e-3 * max(1, x[2])
            assert np.abs(camera.K - K[k]).max() < 1e-3
            depth = (camera.T_camera_world @ np.append(place[k], 1))[2]
            assert abs(depth - places[k][2]) < 1e-4 * x[2]
        return video

    return check
