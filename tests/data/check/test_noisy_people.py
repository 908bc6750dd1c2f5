"""Faults on people whose poses err as an estimator's do, who set_skin_weights clothes and have hair."""

import shutil

import numpy as np
import pytest

from gva_mi.data.check import check_subject
from gva_mi.synthetic import SynthOptions, make_subject

PEOPLE = {  # seeds: what they do, and what goes wrong with their stage 1
    51: ("turn", "mixed"), 52: ("everyday", "bursts"), 53: ("walk", "lean"), 54: ("half", "slow"),
    55: ("dance", "white"), 56: ("turn", "anything"), 57: ("everyday", "mixed"),
    58: ("turn", "bursts"),
}  # fmt: skip

DOUBTS = ("error", "doubtful")


def film(folder, body, seed, motion, family, frames):
    options = SynthOptions(
        seed=seed, motion=motion, family=family, frames=frames, size=128, samples=1,
        novel_poses=0, novel_views=0,
    )  # fmt: skip
    make_subject(folder, options, body)
    return folder


def found(folder, change, tmp_path, body, severity=("error",)):
    """Names of what is found in a broken copy.

    A frame that stage 1 has altogether wrong is rightly called doubtful.
    """
    copy = shutil.copytree(folder, tmp_path / "copy", dirs_exist_ok=True)
    change(copy)
    report = check_subject(copy, body).report
    shutil.rmtree(copy)
    return {finding.what for finding in report.findings if finding.severity in severity}


@pytest.fixture
def broken(known_faults, change_arrays):
    """Ways to break a folder, by what is to be found."""

    def focal(factor):
        longer = np.array([[factor, 1, 1], [1, factor, 1], [1, 1, 1]])
        return lambda folder: change_arrays(folder / "cameras.npz", K=lambda K: K * longer)

    return {
        "frame offset": [known_faults["frame offset"]],  # by two
        "mirrored video": [known_faults["mirrored video"]],
        "focal length or distance": [focal(1 / 1.2), focal(1.5), focal(1.2)],
    }


@pytest.fixture(scope="module")
def walker(tmp_path_factory, built_in_body):
    """16 frames of another person than those above."""
    folder = tmp_path_factory.mktemp("noisy") / "walker"
    return film(folder, built_in_body, 61, "walk", "mixed", 16)


def test_nothing_is_wrong_with_somebody_who_walks(walker, tmp_path, built_in_body):
    assert not found(walker, lambda folder: None, tmp_path, built_in_body)


@pytest.mark.parametrize("name", ["frame offset", "mirrored video"])
def test_a_fault_of_somebody_who_walks_is_named(name, walker, broken, tmp_path, built_in_body):
    for change in broken[name]:
        assert found(walker, change, tmp_path, built_in_body) == {name}


def test_a_heading_that_is_off_is_no_offset(walker, tmp_path, built_in_body, change_arrays):
    """Ten degrees, all the time, to either side."""
    import roma
    import torch

    for angle in (-10.0, 10.0):
        turned = torch.tensor([0.0, np.radians(angle), 0.0])

        def turn(given, turned=turned):
            given = torch.from_numpy(given).float()
            return roma.rotvec_composition([turned.float().expand_as(given), given]).numpy()

        change = lambda folder, turn=turn: change_arrays(folder / "poses.npz", global_orient=turn)
        assert "frame offset" not in found(walker, change, tmp_path, built_in_body)


@pytest.mark.slow
@pytest.mark.parametrize("frames", [8, 24])
def test_how_many_are_named(frames, broken, tmp_path, built_in_body):
    """The figures of docs/own_video.md; ``-s`` prints them."""
    named = {(what, k): 0 for what in broken for k in range(len(broken[what]))}
    for seed, (motion, family) in PEOPLE.items():
        folder = film(tmp_path / str(seed), built_in_body, seed, motion, family, frames)
        assert not found(folder, lambda folder: None, tmp_path, built_in_body), seed
        for what, k in named:
            names = found(folder, broken[what][k], tmp_path, built_in_body, DOUBTS)
            named[what, k] += what in names
    for (what, k), count in named.items():
        print(f"{frames} frames: {what} {k}: {count} of {len(PEOPLE)}")  # noqa: T201
    assert named["mirrored video", 0] > len(PEOPLE) // 2
    assert named["focal length or distance", 1] == len(PEOPLE)
