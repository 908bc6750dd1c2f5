"""A subject and the body it was made on belong together."""

import json
import shutil

import numpy as np
import pytest
import torch

from gva_mi import InputError
from gva_mi.body.body_file import BUILT_IN_BODY
from gva_mi.body.smplx import BodyModel, load_body
from gva_mi.subject.fingerprint import fingerprint, prepared_from, require_listed, require_same_body
from gva_mi.subject.folder import SubjectWriter
from gva_mi.subject.video import load_video


@pytest.fixture(scope="module")
def arrays():
    with np.load(BUILT_IN_BODY) as file:
        return {key: file[key] for key in file.files}


@pytest.fixture(scope="module")
def made_on():
    return fingerprint(load_body())


def written(folder, about, name="synth.json"):
    (folder / name).write_text(json.dumps(about))
    return folder


def test_the_same_body_passes_in_any_precision(made_on, tmp_path):
    folder = written(tmp_path, {"body": made_on})
    require_same_body(folder, load_body())
    require_same_body(folder, load_body(dtype=torch.float64))
    assert fingerprint(load_body()) == made_on


@pytest.mark.parametrize("key", ["v_template", "shapedirs", "posedirs", "weights", "J_regressor"])
def test_the_fingerprint_covers_every_part_of_a_body(arrays, made_on, tmp_path, key):
    other = dict(arrays)
    random = np.random.default_rng(0)
    if key in ("weights", "J_regressor"):  # rows sum to 1
        changed = arrays[key] * random.uniform(0.9, 1.1, arrays[key].shape)
        changed /= changed.sum(1, keepdims=True)
    else:
        changed = 1.02 * arrays[key].astype("f4")
    other[key] = changed.astype(arrays[key].dtype)
    with pytest.raises(InputError, match="its poses belong to another body .* mm from this one"):
        require_same_body(written(tmp_path, {"body": made_on}), BodyModel(other))


@pytest.mark.parametrize("name, theirs", [
    ("synth.json", "the one that gva-mi synth was given"), ("prepare.json", "SMPLX_MALE"),
])  # fmt: skip
def test_a_folder_names_its_body(made_on, tmp_path, name, theirs):
    about = {"name": theirs} if name == "prepare.json" else {}
    for passes in ({"seed": 0}, {"body": made_on | about}):
        require_same_body(written(tmp_path, passes, name), load_body())
    written(tmp_path, {"body": made_on | about | {"vertices": 10475}}, name)
    with pytest.raises(InputError, match=rf"10475 vertices.*expected --body .*\({theirs}\)"):
        require_same_body(tmp_path, load_body())


@pytest.mark.parametrize("text", ["[", '{"body": {"vertices": 3}}'])
def test_a_broken_file_is_named(tmp_path, text):
    (tmp_path / "prepare.json").write_text(text)
    with pytest.raises(InputError, match="prepare.json"):
        require_same_body(tmp_path, load_body())


def test_a_prepared_video_knows_its_frame_rate(tmp_path):
    assert prepared_from(tmp_path) == (None, None)
    for about, expected in (
        ({"kind": "video", "video": {"fps": 12.5}}, ("video", 12.5)),
        ({"kind": "video"}, ("video", None)),
    ):
        (tmp_path / "prepare.json").write_text(json.dumps(about))
        assert prepared_from(tmp_path) == expected


@pytest.mark.parametrize("lost, needs", [
    ("splits.json", "synth.json"), ("truth", "synth.json"), ("truth/poses.npz", "synth.json"),
    ("truth/masks", "synth.json"), ("truth/masks/000002.png", "truth/masks"),
    ("prepare.json", "landmarks.npz"),
])  # fmt: skip
def test_a_file_that_got_lost_is_named(subject, lost, needs):
    """Every one of them changed figures, or took them away, without a word."""
    folder = subject
    shutil.copytree(folder / "masks", folder / "truth/masks")
    shutil.copy(folder / "poses.npz", folder / "truth")
    SubjectWriter(folder).splits({"train": [0, 1], "test": [2]})
    (folder / "landmarks.npz").touch()
    SubjectWriter(folder).record("prepare.json", {})
    SubjectWriter(folder).record("synth.json", {})
    require_listed(folder, 3)
    path = folder / lost
    shutil.rmtree(path) if path.is_dir() else path.unlink()
    with pytest.raises(InputError, match=f"has lost its {lost}, which {needs} needs; restore it"):
        require_listed(folder, 3)


def test_steps_ask_for_lost_files(subject, cli):
    folder = subject
    SubjectWriter(folder).splits({"train": [0, 1], "test": [2]})
    SubjectWriter(folder).record("prepare.json", {"kind": "auto"})
    (folder / "splits.json").unlink()
    with pytest.raises(InputError, match="has lost its splits.json"):
        load_video(folder)
    assert "has lost its splits.json" in " ".join(cli("check", folder)[1].split())
