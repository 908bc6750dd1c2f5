"""``gva-mi refine``: several subjects, several conventions, and frames without evidence."""

import json
import shutil

import numpy as np
import pytest

from gva_mi.body.pose import load_poses, read_pose_file
from gva_mi.body.smplx import load_body
from gva_mi.synthetic import SynthOptions, make_subject

SHORT = ("--size", 48, "--passes", 1)


@pytest.fixture(scope="session")
def synthetic(tmp_path_factory):
    folder = tmp_path_factory.mktemp("subject") / "somebody"
    options = SynthOptions(size=48, frames=3, samples=1, bare=True, novel_poses=0, novel_views=0)
    make_subject(folder, options, load_body())
    return folder


@pytest.fixture
def subject(synthetic, tmp_path):
    return shutil.copytree(synthetic, tmp_path / "somebody")


@pytest.mark.slow
def test_frames_without_evidence_are_listed_and_keep_their_pose(subject, cli):
    (subject / "masks/000001.png").unlink()
    (subject / "normals/000002.png").unlink()
    assert "1 (it has no mask)" in cli.works("refine", subject, *SHORT)
    record = json.loads((subject / "refinement.json").read_text())
    assert record["kept"]["1"] == "it has no mask" and 2 in record["without_normals"]
    before, after = (load_poses(subject / f"poses{x}.npz")[0] for x in ("", "_refined"))
    assert (before.rotations[1] == after.rotations[1]).all()
    assert len(read_pose_file(subject / "poses_refined.npz").offsets) == len(load_body().v_template)


@pytest.mark.slow
def test_a_ground_truth_of_another_length_costs_the_figures_alone(subject, cli):
    path = subject / "truth/poses.npz"
    with np.load(path) as file:
        np.savez(path, **{name: x[:2] if x.ndim > 1 else x for name, x in file.items()})
    out = cli.works("refine", subject, *SHORT)
    assert "is not measured" in out and (subject / "poses_refined.npz").is_file()
    figures = json.loads((subject / "refinement.json").read_text())["figures"]
    assert {row["metric"] for row in figures} == {"stage 1 IoU", "refined IoU", "s a frame"}


BAD = {"nobody": ((), "refine: give the folder of a subject, or of several"),
    "paper, held out": (("nowhere", "--preset", "paper", "--hold-out-test"),
    "--hold-out-test is an option of the refinement of all frames together"),
    "paper, height": (("nowhere", "--preset", "paper", "--height", 1.8),
    "--height is an option of")}  # fmt: skip


def test_bad_input_is_one_sentence_and_exit_code_2(tmp_path, monkeypatch, cli):
    monkeypatch.chdir(tmp_path)
    for command, sentence in BAD.values():
        cli.refuses(sentence, "refine", *command)


def test_the_content_of_held_out_frames_changes_nothing(subject, tmp_path, cli):
    (subject / "splits.json").write_text(json.dumps({"train": [0, 2], "test": [1]}))
    other = shutil.copytree(subject, tmp_path / "other")
    for kind in ("masks", "normals"):
        shutil.copy(other / kind / "000000.png", other / kind / "000001.png")
    cli.works("refine", subject, other, *SHORT, "--hold-out-test")
    found = [load_poses(folder / "poses_refined.npz")[0] for folder in (subject, other)]
    np.testing.assert_array_equal(found[0].rotations, found[1].rotations)
    np.testing.assert_array_equal(found[0].transl, found[1].transl)
    record = json.loads((subject / "refinement.json").read_text())
    assert record["test_frames"] == "held out"
    assert {"", "train", "test"} == {row["split"] for row in record["figures"]}
    stage1 = load_poses(subject / "poses.npz")[0]
    assert not np.array_equal(found[0].rotations[1], stage1.rotations[1])
