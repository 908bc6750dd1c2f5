"""Points that calibrated cameras see together, and one camera's poses against them."""

import json

import numpy as np
import pytest
import torch

from gva_mi.body.pose import JOINTS, Pose, Shape
from gva_mi.core.errors import InputError
from gva_mi.splat import Camera, look_at
from gva_mi.stage1.prepare import PrepareVideoOptions
from gva_mi.stage1.solver import Stage1Solution
from gva_mi.study.multiview import (
    COMPARED_JOINTS,
    CalibratedCamera,
    compare,
    multiview,
    read_calibration,
    triangulate,
)
from gva_mi.subject.landmarks import BODY_LANDMARKS, Landmarks
from gva_mi.subject.video_file import write_video

EYES = (3, 1.5, 0), (0, 1.2, 3), (-3, 2, 0), (0, 0.5, -3)
NAMES = [f"{side}_{name}" for side in ("left", "right") for name in COMPARED_JOINTS]
TABLE = """
[one]
name = "{name}"
size = [640.0, 480.0]
matrix = [[600.0, 0.0, 320.0], [0.0, 610.0, 240.0], [0.0, 0.0, 1.0]]
distortions = [0.1, -0.05, 0.002, -0.001]
rotation = [0.0, 3.141592653589793, 0.0]
translation = [0.0, 1.0, 3.0]
"""
PAIR = TABLE.format(name="a") + TABLE.replace("[one]", "[two]").format(name="b")


@pytest.fixture
def cameras():
    views = [look_at(eye, (0, 1, 0)) for eye in EYES]
    K = np.array([[500.0, 0, 160], [0, 500, 240], [0, 0, 1]])
    return [
        CalibratedCamera(f"cam{k}", (320, 480), K, np.zeros(4), T[:3, :3], T[:3, 3])
        for k, T in enumerate(views)
    ]


def rays_of(cameras, X):
    local = [camera.place(X) for camera in cameras]
    return np.stack([x[..., :2] / x[..., 2:] for x in local])


def test_points_are_found_although_one_camera_is_far_off(cameras):
    X = np.random.default_rng(0).uniform((-0.5, 0, -0.5), (0.5, 2, 0.5), (50, 3))
    rays, seen = rays_of(cameras, X), np.ones((4, 50), bool)
    tau = np.full(4, 0.005)
    np.testing.assert_allclose(triangulate(cameras, rays, seen, tau), X, atol=1e-9)
    rays[1] += 0.3
    seen[0, 0], seen[2:, 1] = False, False
    found = triangulate(cameras, rays, seen, tau)
    assert np.linalg.norm(found[2:] - X[2:], axis=1).max() < 0.005
    seen[1, 1] = False
    assert np.isnan(triangulate(cameras, rays, seen, tau)[1]).all()


def test_a_calibration_is_read_and_its_distortion_undone(tmp_path):
    path = tmp_path / "calibration.toml"
    path.write_text(PAIR)
    one, two = read_calibration(path)
    assert (one.name, two.name, one.size) == ("a", "b", (640, 480))
    np.testing.assert_allclose(one.R, np.diag([-1.0, 1, -1]), atol=1e-12)
    x = np.array([0.3, -0.2])
    r2, (k1, k2, p1, p2) = (x**2).sum(), one.distortion
    seen = x * (1 + k1 * r2 + k2 * r2**2) + 2 * x.prod() * np.array([p1, p2])
    seen += np.array([p2, p1]) * (r2 + 2 * x**2)
    pixels = seen * [600, 610] + [320, 240]
    np.testing.assert_allclose(one.rays(pixels), x, atol=1e-6)


@pytest.mark.parametrize(("text", "problem"),
    [("", "found 0"), ("[one]\nmatrix = 3", "expected a camera's name"), ("[", "expected a"),
    ("[metadata]\nerror = 0.0" + TABLE, "found 1"),
    (TABLE.replace("600.0, 0.0", "600.0, 3.0"), "K must be .*600.0, 3.0, 320.0"),
    (TABLE + "fisheye = true", "one is a fisheye, or does not have 4 or 5 distortion"),
    (TABLE.replace("-0.001]", "-0.001, 0, 0]"), "one is a fisheye, or does not have 4 or 5")],
    )  # fmt: skip
def test_a_file_that_is_no_calibration_is_refused(tmp_path, text, problem):
    path = tmp_path / "calibration.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=problem):
        read_calibration(path)


def test_a_camera_without_a_video_is_named(tmp_path, built_in_body):
    with pytest.raises(InputError, match="nowhere: no such folder"):
        multiview(tmp_path / "nowhere", tmp_path / "a.toml", built_in_body, None, None, False)
    with pytest.raises(InputError, match="none.toml: no such file; expected a camera's name"):
        multiview(tmp_path, tmp_path / "none.toml", built_in_body, None, None, False)
    (tmp_path / "a.toml").write_text(PAIR)
    with pytest.raises(InputError, match="one video of the camera a, of that name, found 0"):
        multiview(tmp_path, tmp_path / "a.toml", built_in_body, None, None, False)


def test_a_video_of_another_size_than_calibrated_is_refused(tmp_path, built_in_body, monkeypatch):
    """Half as large; a calibration of the codec's whole blocks holds."""
    (tmp_path / "a.toml").write_text(PAIR)
    given = tmp_path, tmp_path / "a.toml", built_in_body, PrepareVideoOptions(), np.zeros(3), True
    for name in "ab":
        write_video(tmp_path / f"{name}.mp4", [np.zeros((240, 320, 3), np.uint8)], 30)
    with pytest.raises(InputError, match="a.mp4: 320 x 240 pixels, calibrated with 640 x 480"):
        multiview(*given)
    lenses = []

    def solve(*_, lens, **__):
        lenses.append(float(lens))
        raise InputError("solved")

    monkeypatch.setattr("gva_mi.study.multiview.motion_of_video", solve)
    write_video(tmp_path / "a.mp4", [np.zeros((470, 632, 3), np.uint8)], 30)
    with pytest.raises(InputError, match="solved"):
        multiview(*given)
    assert lenses == [600.0]  # pixels of the video, which is smaller than the side asked for


@pytest.fixture
def solved(cameras, built_in_body):
    """What the first camera would say of a person if nothing were off, and the true points."""
    pose, shape = Pose.rest(3), Shape(torch.zeros(10))
    pose.rotations[:, JOINTS.index("left_elbow"), 1] = torch.tensor([0.0, 0.5, 1.0])
    joints = built_in_body(pose, shape).joints.double().numpy()
    X = np.full((3, len(BODY_LANDMARKS), 3), np.nan)
    X[:, [BODY_LANDMARKS.index(name) for name in NAMES]] = joints[
        :, [JOINTS.index(name) for name in NAMES]
    ]
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = cameras[0].R, cameras[0].t
    camera = Camera.from_matrices(cameras[0].K, T, 320, 480)
    local, one = cameras[0].place(X), np.ones((3, len(BODY_LANDMARKS)))
    pixels = local[..., :2] / local[..., 2:] * 500 + [160, 240]
    landmarks = Landmarks(BODY_LANDMARKS, pixels, one, one, 1.3 * local)
    return Stage1Solution(pose, shape, camera, 0.0), landmarks, X


def compared(*given):
    """The figures of one camera by metric, and by the joint where there is one."""
    return {f.region or f.metric: f.value for f in compare(*given)}


def test_true_poses_have_no_error(cameras, solved, built_in_body):
    recording, landmarks, X = solved
    row = compared(cameras[0], recording, landmarks, built_in_body, X, np.array([0.0, 1, 0]))
    assert row.pop("lens, px") == row.pop("true lens, px") == 500
    assert row.pop("up, degrees") < 1e-3 and np.abs([*row.values()]).max() < 1e-2


def test_errors_are_those_of_the_poses(cameras, solved, built_in_body):
    recording, landmarks, X = solved
    away = cameras[0].R[2] * 0.1  # of the line of sight, in the world
    recording.pose.transl[:] += torch.from_numpy(away).float()
    row = compared(cameras[0], recording, landmarks, built_in_body, X, np.array([0.0, 1, 0]))
    assert [row["depth, mm"], row["joints, mm"]] == pytest.approx([100, 100], abs=0.1)
    assert row["aligned, mm"] < 0.1
    recording.pose.rotations[:, JOINTS.index("left_elbow")] = 0
    up = np.array([0.1, 1, 0]) / 1.01**0.5
    row = compared(cameras[0], recording, landmarks, built_in_body, X, up)
    assert row["wrist"] > 50 and row["elbow"] < 0.1
    assert row["up, degrees"] == pytest.approx(np.degrees(np.arctan(0.1)), abs=1e-3)


@pytest.mark.slow
def test_the_command_prints_a_row_for_each_camera(tmp_path, built_in_body):
    from gva_mi.__main__ import main
    from gva_mi.synthetic import SynthOptions, make_subject

    options = SynthOptions(seed=101, frames=12, size=256, samples=4, novel_poses=0, novel_views=0)
    make_subject(tmp_path / "take", options, built_in_body)
    recordings = tmp_path / "videos"
    recordings.mkdir()
    for name in "ab":
        (recordings / f"{name}.mp4").write_bytes((tmp_path / "take/video.mp4").read_bytes())
    (tmp_path / "cameras.toml").write_text(PAIR.replace("640.0, 480.0", "256.0, 256.0"))
    main(["study", "multiview", str(recordings), str(tmp_path / "cameras.toml"), "--height", "1.7",
        "--json", str(tmp_path / "a.json")])  # fmt: skip
    figures = json.loads((tmp_path / "a.json").read_text())["figures"]
    lens = {row["subject"]: row["value"] for row in figures if row["metric"] == "lens, px"}
    assert set(lens) == {"a", "b"} and lens["a"] == lens["b"] != 600
