"""Each fault is named by a problem of its own, and a good folder has none."""

import json
from pathlib import Path

import numpy as np
import pytest
from samples.broken_cases import poses
from samples.faults import FAULTS

from gva_mi import InputError
from gva_mi.data.check import check_subject
from gva_mi.data.check.silhouettes import accepts

ALSO = {  # problems that follow from a fault, beside the one that names it
    "poses in millimetres": {"jumps"},
    "poses in degrees": {"rotations"},
    "K is of another picture size": {"principal point"},
    "masks beside the poses": {"principal point"},
}
QUICK = {  # one of each kind
    "T_camera_world is inverted", "poses in millimetres", "K is of another picture size",
    "focal length or distance", "masks beside the poses", "full masks", "mirrored video",
    "normals cannot be read", "betas", "counts", "picture size", "unreadable",
}  # fmt: skip


def whats(report):
    return {problem.what for problem in report.problems}


def test_a_good_folder_has_no_problem(whole, built_in_body):
    report, _, _ = check_subject(whole, built_in_body)
    assert not report.problems and not report.skipped
    assert report.figures["iou"] > 0.95 and report.figures["joints_inside"] > 0.95


@pytest.mark.parametrize(
    "name", [pytest.param(x, marks=() if x in QUICK else pytest.mark.slow) for x in FAULTS]
)
def test_a_fault_is_named(name, subject, built_in_body):
    FAULTS[name](subject)
    report, _, _ = check_subject(subject, built_in_body)
    assert {name} <= whats(report) <= {name} | ALSO.get(name, set())
    first = next(p for p in report.problems if p.what == name)
    assert first.severity == "error" and first.figure and first.cause and first.remedy


def test_several_faults_are_named_in_one_pass(subject, built_in_body):
    names = {"inverted masks", "cameras in OpenGL's axes", "splits", "axes of the normals"}
    for name in names:
        FAULTS[name](subject)
    report, _, _ = check_subject(subject, built_in_body)
    assert names <= whats(report)
    assert report.problems == sorted(report.problems, key=lambda p: p.severity != "error")


def test_frames_with_another_person_are_listed(subject, built_in_body):
    away = np.float32(1.2) * (np.arange(8) == 5)[:, None]
    poses(transl=lambda x: x + away)(subject)
    report, _, _ = check_subject(subject, built_in_body)
    outside = next(p for p in report.problems if p.what == "poses outside the masks")
    assert outside.severity == "doubtful" and outside.frames == (5,) and not report.errors


def test_poses_that_are_never_in_the_masks_are_an_error(subject, built_in_body):
    sides = np.where(np.arange(8) % 2, 1.3, -1.3)[:, None] * [[1, 0, 0]]
    poses(transl=lambda x: (x + sides).astype("f4"))(subject)
    report, _, _ = check_subject(subject, built_in_body)
    assert {p.what for p in report.errors} == {"poses outside the masks"}


def test_a_folder_for_another_body_is_named(subject, built_in_body):
    about = {"name": "SMPLX_MALE", "vertices": 10475, "sketch": [0.0] * 32}
    (subject / "prepare.json").write_text(json.dumps({"body": about}))
    report, _, _ = check_subject(subject, built_in_body)
    assert "SMPLX_MALE" in next(p for p in report.problems if p.what == "another body").figure


def test_what_is_no_subject_cannot_be_checked(tmp_path, built_in_body):
    with pytest.raises(InputError, match="no such folder"):
        check_subject(tmp_path / "nowhere", built_in_body)
    with pytest.raises(InputError, match="no subject's folder"):
        check_subject(tmp_path, built_in_body)


def test_a_gain_has_to_be_sure_and_worth_a_word():
    plain = np.full(12, 0.5)
    assert accepts(np.full(12, 0.11), plain) and not accepts(np.full(12, 0.09), plain)
    assert not accepts(np.where(np.arange(12) % 2, 0.6, -0.3), plain)
    assert not accepts(np.full(3, 0.3), plain)


def test_the_command_prints_writes_and_ends_with_its_code(subject, cli):
    out, sheet = subject.parent / "found.json", subject.parent / "sheet.png"
    assert "8 frames, 0 errors, 0 doubtful; mean IoU" in cli.works("check", subject)
    FAULTS["splits"](subject)
    code, said, err = cli("check", subject, "--json", out, "--sheet", sheet)
    assert code == 1 and "splits" in said and "what to do" in said
    found = json.loads(out.read_text())
    assert [f["what"] for f in found["findings"]] == ["splits"] and found["frames"] == 8
    assert sheet.stat().st_size
    assert "--overwrite" in cli.fails("check", subject, "--json", out)
    assert "nowhere: no such folder" in cli.fails("check", Path("nowhere"))


def test_the_sheet_shows_both_outlines(whole, built_in_body):
    from gva_mi.data.check.sheet import MASK, draw_sheet
    from gva_mi.mesh.overlay import OUTLINE

    _, files, shown = check_subject(whole, built_in_body)
    sheet = draw_sheet(files, shown, built_in_body)
    for color in (MASK, OUTLINE):
        assert (np.abs(sheet - np.float32(color)).max(-1) < 1e-3).sum() > 200
