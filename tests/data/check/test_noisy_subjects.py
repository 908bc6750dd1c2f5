"""Faults of synthetic subjects in clothes, with hair, whose poses err as an estimator's do."""

import shutil

import pytest
from samples import faults

from gva_mi.data.check import check_subject
from gva_mi.synthetic import SynthOptions, make_subject

SUBJECTS = {  # seed: motion, error model of stage 1
    51: ("turn", "mixed"), 52: ("everyday", "bursts"), 53: ("walk", "lean"), 54: ("half", "slow"),
    55: ("dance", "white"), 56: ("turn", "anything"), 57: ("everyday", "mixed"),
    58: ("turn", "bursts"),
}  # fmt: skip
BROKEN = {  # fault: the problem that names it, and how the folder is broken
    "none": ("", lambda folder: None),
    "mirrored video": ("mirrored video", faults.FAULTS["mirrored video"]),
    "focal length 1.2 times too short": ("focal length or distance", faults.longer(1 / 1.2)),
    "focal length 1.5 times too long": ("focal length or distance", faults.longer(1.5)),
}


def make(folder, body, seed, motion, error_model, frames):
    options = SynthOptions(
        seed=seed, motion=motion, error_model=error_model, frames=frames, size=128, samples=1,
        novel_poses=0, novel_views=0,
    )  # fmt: skip
    make_subject(folder, options, body)
    return folder


def problems(folder, change, tmp_path, body, severities=("error",)):
    """Names of the problems of a broken copy."""
    copy = shutil.copytree(folder, tmp_path / "copy")
    change(copy)
    report, _, _ = check_subject(copy, body)
    shutil.rmtree(copy)
    return {problem.what for problem in report.problems if problem.severity in severities}


@pytest.fixture(scope="module")
def walker(tmp_path_factory, built_in_body):
    """16 frames of another subject than those above."""
    folder = tmp_path_factory.mktemp("noisy") / "walker"
    return make(folder, built_in_body, 61, "walk", "mixed", 16)


@pytest.mark.parametrize("fault", ["none", "mirrored video"])
def test_a_fault_of_a_walking_subject_is_named_and_no_other(fault, walker, tmp_path, built_in_body):
    what, change = BROKEN[fault]
    assert problems(walker, change, tmp_path, built_in_body) == ({what} if what else set())


@pytest.mark.slow
@pytest.mark.parametrize("frames", [8, 24])
def test_detection_rates(frames, tmp_path, built_in_body):
    """The table of docs/own_video.md, which ``-s`` prints: faults named of those that were made."""
    named = dict.fromkeys(BROKEN, 0)
    for seed, (motion, error_model) in SUBJECTS.items():
        folder = make(tmp_path / str(seed), built_in_body, seed, motion, error_model, frames)
        for fault, (what, change) in BROKEN.items():
            severities = ("error", "doubtful") if what else ("error",)
            found = problems(folder, change, tmp_path, built_in_body, severities)
            named[fault] += what in found if what else bool(found)
    for fault, count in named.items():
        print(f"{frames} frames | {fault} | {count} of {len(SUBJECTS)}")  # noqa: T201
    assert named["none"] == 0
    assert named["mirrored video"] > len(SUBJECTS) // 2
    assert named["focal length 1.5 times too long"] == len(SUBJECTS)
