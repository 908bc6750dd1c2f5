"""Files in exactly the form of each estimator: the person stands where the file says."""

import re

import numpy as np
import pytest
from samples.estimates import CENTRED, HEIGHT, WIDTH, WRITTEN, dumped, named, of_smpl

from gva_mi.core.errors import InputError
from gva_mi.readers.estimator_layouts import VideoInfo, people_by_name, wham_lens
from gva_mi.readers.estimators import KINDS, Estimator, read_estimator
from gva_mi.readers.people import follow
from gva_mi.readers.source_files import has_one


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


def test_missing_or_encoded_parameters_are_named(tmp_path, seen):
    def refused(words, source, kind="auto", **info):
        with pytest.raises(InputError, match=words):
            read_estimator(kind, source, VideoInfo((WIDTH, HEIGHT), **info))

    np.savez(tmp_path / "p.npz", **named(*seen))
    refused("holds no camera.*give --lens", tmp_path / "p.npz")
    np.savez(tmp_path / "no.npz", **{k: x for k, x in named(*seen).items() if k != "transl"})
    refused(r"no translation; expected transl \(T, 3\)", tmp_path / "no.npz", focal=70)


def test_arrays_without_names_other_bodies_and_damage_are_refused(tmp_path, refused):
    np.save(tmp_path / "flat.npy", np.zeros((5, 265)))
    refused(r"unknown estimator format, holds one ndarray \(5, 265\) without names",
        tmp_path / "flat.npy")  # fmt: skip
    res = {"pred_thetas": np.zeros((1, 7)), "pred_cam_root": 0, "bbox": 0, "img_path": ["x"]}
    refused("\\(read as hybrik\\): unexpected format", dumped(tmp_path / "r.pk", res))


def test_another_estimator_is_one_record(tmp_path, seen, monkeypatch):
    """The example in the module's docstring."""
    mine = Estimator(
        expects="people with theta and camera_t",
        recognises=lambda found: has_one(found, "theta", "camera_t"),
        people=people_by_name("theta"),
        arrays={"poses": "theta", "transl": "camera_t"},
        lens=wham_lens,
    )
    monkeypatch.setitem(KINDS, "mine", mine)
    rotations, places = seen
    poses = of_smpl(rotations).reshape(-1, 72)
    person = {"theta": poses, "camera_t": places, "frame_ids": np.arange(len(poses)) + 3}
    file = dumped(tmp_path / "mine.pkl", {"0": person})
    kind, (track,) = read_estimator("auto", file, VideoInfo((WIDTH, HEIGHT)))
    assert kind == "mine" and track.frames.tolist() == list(range(3, 3 + len(poses)))
    assert np.allclose(track.rotations[:, :22], rotations[:, :22])


def test_the_nearest_person_keeps_the_name():
    a, b = np.array([0.0, 0, 4]), np.array([0.6, 0, 4])
    named = follow([[a], [b, a], [a, b], [], [b + 0.1]])
    assert named == [["0"], ["1", "0"], ["0", "1"], [], ["1"]]
    assert follow([[a], [a + 5]]) == [["0"], ["1"]]


@pytest.mark.parametrize("lens", ["K", "focal"])
def test_a_camera_of_larger_pictures_is_scaled_to_the_videos(lens, tmp_path, seen):
    """Where a file records the size of its pictures."""
    of_lens = {"K": CENTRED(80) * 2 * [[1], [1], [0.5]], "focal": np.array(160.0)}[lens]
    size = {"width": 2 * WIDTH, "height": np.full(len(seen[0]), 2 * HEIGHT)}
    np.savez(tmp_path / "p.npz", **named(*seen), **{lens: of_lens}, **size)
    _, (track,) = read_estimator("auto", tmp_path / "p.npz", VideoInfo((WIDTH, HEIGHT)))
    assert np.allclose(track.K, CENTRED(80))
    with pytest.raises(InputError, match="is of pictures of 128x96, but the video has 64x64"):
        read_estimator("auto", tmp_path / "p.npz", VideoInfo((WIDTH, WIDTH)))


def test_a_skew_ends_prepare(tmp_path, refused, seen):
    K = CENTRED(80) + [[0, 3, 0], [0, 0, 0], [0, 0, 0]]
    np.savez(tmp_path / "p.npz", **named(*seen, K=K))
    refused(r"K must be .*, got \[80.0, 3.0, 32.0.*without skew", tmp_path / "p.npz")
