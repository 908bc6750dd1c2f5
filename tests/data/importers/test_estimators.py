"""Files in exactly the form of each estimator: the person stands where the file says."""

import json
import re

import numpy as np
import pytest
from samples.estimates import (
    CENTRED,
    HEIGHT,
    WIDTH,
    WRITTEN,
    dumped,
    frame_of_osx,
    named,
    osx,
    smplerx,
    smplifyx,
    written,
)

from gva_mi.core.errors import InputError
from gva_mi.data.importers.estimators import VideoInfo, read_estimator
from gva_mi.data.importers.lens import rescaled
from gva_mi.data.importers.people import follow


@pytest.mark.parametrize("name", WRITTEN)
def test_the_person_stands_where_the_estimator_saw_them(name, tmp_path, cli, seen, footage, stands):
    source, words, K, places, *more = WRITTEN[name](tmp_path, *seen)
    rotations, joints, *given = more or (seen[0], 22)
    footage = footage if "--body" not in given else footage[2:]
    assert words in cli.works("prepare", "auto", source, tmp_path / "s", *footage, *given)
    stands(tmp_path / "s", rotations, places, K, joints)


@pytest.fixture
def refused(tmp_path, cli, footage):
    def run(words, source, *more):
        err = cli.fails("prepare", "auto", source, tmp_path / "s", *footage, *more)
        assert re.search(words, err) and err.count("\n") <= 2, err
        assert not (tmp_path / "s").exists()

    return run


def test_frames_that_lie_beyond_the_video_are_refused(tmp_path, seen, refused):
    source, *_ = smplerx(tmp_path, *seen)
    refused("has frame 5, but the video has frames 0 to 4; --first", source, "--first", 0)


def test_missing_or_encoded_parameters_are_named(tmp_path, seen):
    def refused(words, source, kind="auto", **info):
        with pytest.raises(InputError, match=words) as error:
            read_estimator(kind, source, VideoInfo((WIDTH, HEIGHT), **info))
        assert "\n" not in str(error.value)

    rotations, transl = seen
    np.savez(tmp_path / "p.npz", **named(*seen))
    refused("says no camera.*give --focal", tmp_path / "p.npz")
    np.savez(tmp_path / "no.npz", **{k: x for k, x in named(*seen).items() if k != "transl"})
    refused(r"no translation; expected transl \(T, 3\)", tmp_path / "no.npz", focal=70)
    latent, *_ = smplifyx(tmp_path / "latent", *seen, body=np.zeros((1, 32), "f4"))
    refused("latent code of VPoser", latent)
    bare = frame_of_osx(rotations[0], transl[0])
    del bare["trans"]  # as some forks of SMPLest-X write
    written(tmp_path / "bare/0.json", bare)
    refused("says no place of the person; expected trans", tmp_path / "bare", "osx")
    written(tmp_path / "blind/0.json", frame_of_osx(rotations[0], transl[0]))
    refused("cam_params/0.json: no such file; expected a camera", tmp_path / "blind", "osx")
    written(tmp_path / "odd/0.json", {"smplx_param": bare | {"trans": [0, 0, 3]}, "cam_param": {}})
    refused(r"expected a camera such as \{\"focal\"", tmp_path / "odd", "osx")
    written(tmp_path / "name/a.json", {"smplx_param": bare, "cam_param": {"focal": [1, 1]}})
    refused("expected the number of a frame", tmp_path / "name", "osx")
    short, *_ = osx(tmp_path / "short", *seen)
    third = json.loads((short / "2_0.json").read_text())
    third["smplx_param"]["body_pose"] = third["smplx_param"]["body_pose"][:30]
    written(short / "2_0.json", third)
    refused("'body_pose' is not of one shape in all frames", short, "osx")


def test_arrays_without_names_other_bodies_and_damage_are_refused(tmp_path, refused):
    np.save(tmp_path / "flat.npy", np.zeros((5, 265)))
    refused(r"an array \(5, 265\) without names.*save them by name", tmp_path / "flat.npy")
    mhr = [{"pred_vertices": np.zeros((9, 3)), "pred_cam_t": np.zeros(3), "focal_length": 900.0,
            "body_pose_params": np.zeros(133), "shape_params": np.zeros(45)}]  # fmt: skip
    words = "parameters of MHR, as SAM 3D Body writes"
    refused(words, dumped(tmp_path / "frames.pkl", {"0.jpg": {"people": mhr}}))
    (tmp_path / "out").mkdir()
    np.savez(tmp_path / "out/0000.npz", data=np.array(mhr, object))
    refused("out: holds " + words, tmp_path / "out")
    res = {"pred_thetas": np.zeros((1, 7)), "pred_cam_root": 0, "bbox": 0, "img_path": ["x"]}
    refused("\\(of the kind hybrik\\): of another form", dumped(tmp_path / "r.pk", res))


def test_the_nearest_person_keeps_the_name():
    a, b = np.array([0.0, 0, 4]), np.array([0.6, 0, 4])
    named = follow([[a], [b, a], [a, b], [], [b + 0.1]])
    assert named == [["0"], ["1", "0"], ["0", "1"], [], ["1"]]
    assert follow([[a], [a + 5]]) == [["0"], ["1"]]


def test_a_lens_of_another_size_is_scaled():
    K = rescaled("x", CENTRED(10), (WIDTH, HEIGHT), (2 * WIDTH, 2 * HEIGHT))
    assert np.allclose(K, [[20, 0, WIDTH], [0, 20, HEIGHT], [0, 0, 1]])
    with pytest.raises(InputError, match="expected the same shape"):
        rescaled("x", CENTRED(10), (0, 0), (WIDTH, HEIGHT))
