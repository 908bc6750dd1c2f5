"""Subjects broken by hand: each is taken, or refused in one sentence before any work is done.

What one step refuses, ``gva-mi check`` has to find.
"""

import importlib.util
from pathlib import Path

import pytest

spec = importlib.util.spec_from_file_location("subjects", Path(__file__).with_name("subjects.py"))
subjects = importlib.util.module_from_spec(spec)
spec.loader.exec_module(subjects)

SUBJECTS = subjects.SUBJECTS
TAKEN = {  # other numbers than were meant, of which check says what it sees; or frames left out
    "K has skew", "K has a focal length of 1e300", "K looks far aside", "T is inverted",
    "transl is behind the camera", "transl is in millimetres", "betas are a table",
    "betas are none", "betas are 300", "all test frames are absent",
    "a frame is grey", "a frame is of 16 bits", "a frame has alpha", "a frame has a palette",
    "a frame is a .jpg", "a frame is missing", "the first frame is missing",
    "a mask is of 16 bits", "a mask has a palette", "a mask is of one bit", "a mask is black",
    "a mask is white", "a mask is missing", "masks are inverted", "masks are of zero and one",
    "masks are all white", "masks are of one pixel", "masks lie upside down",
    "normals of zero length", "normals of NaN", "normals of a thousand",
    "normals.json without normals", "normals are a file",
    'normals.json says {"convention": "icon"}', 'normals.json says {"convention": "icon", "boxes"',
    'prepare.json says {"body": 3}', 'prepare.json says {"figures": {"iou": "x",',
    'synth.json says {"body": 3}', 'synth.json says {"figures": {"iou": "x",',
}  # fmt: skip
NOT_READ = ("refinement.json", "noise.json", "truth", "views")  # by a fit
NOT_IN_THE_MASKS = {
    "K has a focal length of 1e300", "K looks far aside", "transl is behind the camera",
    "transl is in millimetres", "masks are inverted", "masks are of one pixel",
}  # fmt: skip


@pytest.fixture
def no_work(monkeypatch):
    """``fit`` does all but its work."""
    monkeypatch.setattr("gva_mi.cli.fit.fit_video", lambda *_, **__: None)


@pytest.mark.parametrize("name", SUBJECTS)
def test_fit_takes_it_or_says_why(name, copied, no_work, refused_or_taken, tmp_path, monkeypatch):
    doubts = []
    monkeypatch.setattr("gva_mi.cli.arguments.say", doubts.append)
    SUBJECTS[name](copied)
    refused = refused_or_taken("fit", copied, "--out", tmp_path / "out")
    if name == "offsets are of another body":
        return  # which the fit itself finds, and check
    assert (refused is None) == (name in TAKEN or name.startswith(NOT_READ)), refused
    assert refused is None or str(copied) in refused and not (tmp_path / "out/avatar.npz").exists()
    if name in NOT_IN_THE_MASKS:
        assert any("of the body's joints lie in the " in line for line in doubts)


@pytest.mark.slow
@pytest.mark.parametrize("name", SUBJECTS)
def test_check_finds_what_fit_refuses(name, copied, cli):
    SUBJECTS[name](copied)
    code, said, err = cli("check", copied)
    refused = name not in TAKEN and not name.startswith((*NOT_READ, "poses_refined"))
    assert code in (1, 2) if refused else code in (0, 1), said + err
    assert "Traceback" not in err


@pytest.mark.slow
@pytest.mark.parametrize("name", [*TAKEN, *(n for n in SUBJECTS if n.startswith(NOT_READ))])
def test_what_is_taken_is_refined_to_its_end(name, copied, refused_or_taken):
    SUBJECTS[name](copied)
    refused_or_taken("refine", copied, "--passes", 1, "--size", 32, "--faces", 1000)


def test_there_are_hundreds():
    assert len(SUBJECTS) >= 190 and set(SUBJECTS) >= TAKEN
