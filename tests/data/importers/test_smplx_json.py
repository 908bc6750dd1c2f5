"""JSON of OSX, forks of SMPLest-X, and ExAvatar: the person stands where they saw them."""

import json

import numpy as np
import pytest

from gva_mi.body.built_in import BUILT_IN_BODY
from gva_mi.body.smplx import load_body
from gva_mi.core.errors import InputError
from gva_mi.data.importers.estimator_record import VideoInfo
from gva_mi.data.importers.estimators import read_estimator
from gva_mi.data.pictures import read_image, write_image
from gva_mi.data.video import load_video

WIDTH, HEIGHT, FRAMES = 64, 48, 5
SMPLX = np.array([0.0031, -0.3514, 0.0120])
LENS = np.array([[300.0, 0, 30], [0, 310, 25], [0, 0, 1]])


def lens_of(k):
    """A lens a frame, as such networks have that look at a box."""
    return LENS + np.array([[10.0 * k, 0, k], [0, 10 * k, -k], [0, 0, 0]])


def params(rotations, transl, fork=False):
    flat = lambda part: rotations[part].ravel().tolist()
    left, right = ("left_hand_pose", "right_hand_pose") if fork else ("lhand_pose", "rhand_pose")
    return {
        "root_pose": flat(slice(0, 1)), "body_pose": flat(slice(1, 22)), left: flat(slice(25, 40)),
        right: flat(slice(40, 55)), "jaw_pose": flat(slice(22, 23)),
        "betas" if fork else "shape": [0.0] * 10, "expression" if fork else "expr": [0.0] * 10,
        "translation" if fork else "trans": np.asarray(transl).tolist(),
    }  # fmt: skip


def written(path, value):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(value))


def osx(folder, seen, first=0):
    """In every second frame somebody else comes first, who is farther away and aside."""
    rotations, transl = seen
    for k in range(FRAMES):
        K = lens_of(k)
        cam = {"focal": [K[0, 0], K[1, 1]], "princpt": [K[0, 2], K[1, 2]]}
        people = [params(rotations[k], transl[k])]
        if k % 2:
            people.insert(0, params(rotations[k], transl[k] + (2.0, 0.0, 3.0)))
        for i, person in enumerate(people):
            written(folder / f"{k + first}_{i}.json", {"smplx_param": person, "cam_param": cam})
    return folder


def smplest_x(folder, seen):
    """A run a picture, named by it, and a folder a person."""
    rotations, transl = seen
    for k in range(FRAMES):
        K = lens_of(k)
        run = folder / f"inference_output_20250604_20374{k}_frame{k}/person_0"
        person = params(rotations[k], transl[k], fork=True)
        written(run / "smplx_params_person_0.json", person | {"mesh": [[0.0, 0.0, 0.0]]})
        written(run / "smplx_shapes_person_0.json", {"bbox_id": 0})
        camera = {"focal_length": [K[0, 0], K[1, 1]], "principal_point": [K[0, 2], K[1, 2]]}
        written(run / "camera_metadata.json", camera | {"camera_translation": [0, 0, 0]})
    return folder


def with_mean_hands(rotations):
    with np.load(BUILT_IN_BODY) as body:
        mean = np.concatenate([body["hands_meanl"], body["hands_meanr"]]).reshape(30, 3)
    rotations = rotations.copy()
    rotations[:, 25:] += mean
    rotations[:, 23:25] = 0  # no eyes
    return rotations


@pytest.mark.parametrize("form", ["osx", "fork"])
def test_parameters_a_frame(form, tmp_path, cli, seen, footage, stands):
    rotations, transl = seen
    source = osx(tmp_path / "o", seen) if form == "osx" else smplest_x(tmp_path / "o", seen)
    code, said, err = cli("prepare", "auto", source, tmp_path / "s", *footage)
    assert code == 0, err
    assert "osx, SMPL-X, 5 frames of 64x48" in said
    K = np.stack([lens_of(k) for k in range(FRAMES)])
    stands(tmp_path / "s", with_mean_hands(rotations), SMPLX + transl, K, joints=55)
    if form == "osx":
        assert "person 0, " in said and "1 (2 frames" in said


def test_missing_parameters_are_named(tmp_path, seen):
    def refused(words, folder):
        with pytest.raises(InputError, match=words) as error:
            read_estimator("osx", folder, VideoInfo((WIDTH, HEIGHT)))
        assert "\n" not in str(error.value)

    rotations, transl = seen
    bare = params(rotations[0], transl[0])
    del bare["trans"]  # as some forks of SMPLest-X write
    written(tmp_path / "bare/0.json", bare)
    refused("says no place of the person; expected trans", tmp_path / "bare")
    written(tmp_path / "blind/0.json", params(rotations[0], transl[0]))
    refused("cam_params/0.json: no such file; expected a camera such as", tmp_path / "blind")
    written(tmp_path / "odd/0.json", {"smplx_param": bare | {"trans": [0, 0, 3]}, "cam_param": {}})
    refused(r"expected a camera such as \{\"focal\"", tmp_path / "odd")
    written(tmp_path / "name/a.json", {"smplx_param": bare, "cam_param": {"focal": [1, 1]}})
    refused("expected the number of a frame", tmp_path / "name")
    osx(tmp_path / "short", seen)
    third = json.loads((tmp_path / "short/2_0.json").read_text())
    third["smplx_param"]["body_pose"] = third["smplx_param"]["body_pose"][:30]
    written(tmp_path / "short/2_0.json", third)
    refused("'body_pose' is not of one shape in all frames", tmp_path / "short")


@pytest.fixture
def exavatar(tmp_path, seen):
    """Of frames 3, 4, 6, 7 and 9 of a video; the camera of 7 is turned."""
    folder = tmp_path / "subject_1"
    rotations, transl = seen
    random = np.random.default_rng(0)
    for k, number in enumerate((3, 4, 6, 7, 9)):
        image = random.integers(0, 255, (HEIGHT, WIDTH, 3), dtype=np.uint8)
        write_image(folder / f"frames/{number}.png", image)
        mask = np.zeros((HEIGHT, WIDTH), np.uint8)
        mask[5 + k : 40, 20:40] = 255
        write_image(folder / f"masks/{number}.png", mask)
        written(folder / f"smplx_optimized/smplx_params_smoothed/{number}.json",
                params(rotations[k], transl[k]))  # fmt: skip
        K = lens_of(k)
        camera = {"R": np.eye(3).tolist(), "t": [0.0, 0.0, 0.5], "focal": [K[0, 0], K[1, 1]],
                  "princpt": [K[0, 2], K[1, 2]]}  # fmt: skip
        written(folder / f"cam_params/{number}.json", camera)
    write_image(folder / "frames/12.png", image)  # not fitted
    written(folder / "smplx_optimized/shape_param.json", [0.0] * 100)
    (folder / "frame_list_train.txt").write_text("3\n4\n6\n")
    (folder / "frame_list_test.txt").write_text("9\n12\n")
    return folder


def test_exavatar(exavatar, tmp_path, cli, seen, stands):
    rotations, transl = seen
    code, said, err = cli("prepare", "auto", exavatar, tmp_path / "s", "--body", "puppet")
    assert code == 0, err
    assert "exavatar, SMPL-X, 5 frames of 64x48" in said and "are ExAvatar's own" in said
    K = np.stack([lens_of(k) for k in range(FRAMES)])
    places = SMPLX + transl + (0.0, 0.0, 0.5)
    video = stands(tmp_path / "s", with_mean_hands(rotations), places, K, joints=55)
    assert video[3].mask[:8].max() == 0 and video[3].mask[8, 25] == 1
    assert (video.splits.train, video.splits.test) == ([0, 1, 2], [4])
    seen_there = read_image(exavatar / "frames/7.png", 3)
    assert np.array_equal(read_image(tmp_path / "s/frames/000003.png", 3), seen_there)


def test_betas_beyond_the_body_s_are_dropped(exavatar, tmp_path, cli):
    """ExAvatar's shape has a hundred numbers, a file of SMPL-X's first version ten."""
    with np.load(BUILT_IN_BODY) as arrays:
        body = {key: arrays[key] for key in arrays.files}
    np.savez(tmp_path / "SMPLX_NEUTRAL.npz", **body)
    betas = np.linspace(-1, 1, 100)
    written(exavatar / "smplx_optimized/shape_param.json", betas.tolist())
    code, said, err = cli(
        "prepare", "auto", exavatar, tmp_path / "s", "--body", tmp_path / "SMPLX_NEUTRAL.npz"
    )
    assert code == 0, err
    kept = load_body(tmp_path / "SMPLX_NEUTRAL.npz").num_betas
    assert f"the first {kept} betas are kept, which this body's file has" in said
    found = load_video(tmp_path / "s").shape.betas.numpy()
    assert np.allclose(found, betas[:kept].astype(np.float32))
