"""Each fault is named by a finding of its own; and where nothing is wrong, nothing is found."""

import json
from pathlib import Path

import numpy as np
import pytest

from gva_mi import InputError
from gva_mi.data.check import check_subject

# Findings that follow from a fault, beside the one that names it.
ALSO = {
    "poses in millimetres": {"jumps"},
    "poses in degrees": {"rotations"},
    "K is of another picture size": {"principal point"},
    "masks beside the poses": {"principal point"},
    "empty masks": {"splits of absent frames"},
    "masks of labels": {"splits of absent frames"},
    "missing masks": {"splits of absent frames"},
    "picture size": {"mask size"},
}
NAMES = [
    *("K is not normalised", "K is transposed", "T_camera_world is mirrored"),
    *(
        "T_camera_world is transposed",
        "T_camera_world has a scale",
        "T_camera_world is no rotation",
    ),
    *("T_camera_world is inverted", "cameras in OpenGL's axes", "poses in a world with y down"),
    *("poses in a world with z up", "cameras in millimetres", "poses in millimetres"),
    *("poses in degrees", "K is of another picture size", "focal length or distance"),
    *("masks beside the poses", "inverted masks", "full masks", "empty masks", "masks of labels"),
    *("mask size", "missing masks", "mirrored video", "pictures upside down", "frame offset"),
    *("axes of the normals", "few normals", "normals cannot be read", "betas"),
    *("poses are not finite", "counts", "splits overlap", "splits beyond the video"),
    *("picture size", "unreadable", "views of other cameras"),
]


def whats(report):
    return {finding.what for finding in report.findings}


def test_nothing_is_wrong(whole, built_in_body):
    checked = check_subject(whole, built_in_body)
    assert not checked.report.findings and not checked.report.skipped
    assert checked.report.figures["iou"] > 0.95 and checked.report.figures["joints_inside"] > 0.95


def test_every_fault_is_tried(known_faults):
    assert sorted(NAMES) == sorted(known_faults)


@pytest.mark.parametrize("name", NAMES)
def test_a_fault_is_named(name, subject, known_faults, built_in_body):
    known_faults[name](subject)
    report = check_subject(subject, built_in_body).report
    assert name in whats(report)
    assert whats(report) <= {name} | ALSO.get(name, set())
    first = next(f for f in report.findings if f.what == name)
    assert first.severity == ("doubtful" if name == "few normals" else "error")
    assert first.figure and first.cause and first.remedy


def test_several_faults_are_found_in_one_pass(subject, known_faults, built_in_body):
    names = {"inverted masks", "cameras in OpenGL's axes", "K is not normalised", "splits overlap"}
    for name in [*names, "axes of the normals"]:
        known_faults[name](subject)
    report = check_subject(subject, built_in_body).report
    assert names | {"axes of the normals"} <= whats(report)
    assert [f.severity for f in report.findings] == sorted(
        (f.severity for f in report.findings), key=lambda s: s != "error"
    )


def test_some_frames_are_named(subject, built_in_body):
    path = subject / "poses.npz"
    with np.load(path) as file:
        arrays = {key: file[key] for key in file.files}
    arrays["transl"][5] += np.array([1.2, 0, 0], "f4")
    np.savez(path, **arrays)
    report = check_subject(subject, built_in_body).report
    outside = next(f for f in report.findings if f.what == "poses outside the masks")
    assert outside.severity == "doubtful" and outside.frames == (5,)
    assert not report.errors


def test_another_person_is_outside_the_masks(subject, built_in_body):
    path = subject / "poses.npz"
    with np.load(path) as file:
        arrays = {key: file[key] for key in file.files}
    arrays["transl"] += np.where(np.arange(8) % 2, 1.3, -1.3)[:, None].astype("f4") * [[1, 0, 0]]
    np.savez(path, **{k: v.astype("f4") for k, v in arrays.items()})
    errors = {f.what for f in check_subject(subject, built_in_body).report.errors}
    assert errors == {"poses outside the masks"}


def test_a_person_far_away_is_told(subject, built_in_body, known_faults):
    path = subject / "cameras.npz"
    with np.load(path) as file:
        arrays = {key: file[key] for key in file.files}
    arrays["T_camera_world"][..., 2, 3] += 5000
    np.savez(path, **arrays)
    assert "cameras far from the person" in whats(check_subject(subject, built_in_body).report)


def test_a_folder_for_another_body_is_told(subject, built_in_body):
    about = {"name": "SMPLX_MALE", "vertices": 10475, "sketch": [0.0] * 32}
    (subject / "prepare.json").write_text(json.dumps({"body": about}))
    report = check_subject(subject, built_in_body).report
    assert "SMPLX_MALE" in next(f for f in report.findings if f.what == "another body").figure


def test_what_is_no_subject_cannot_be_checked(tmp_path, built_in_body):
    with pytest.raises(InputError, match="no such folder"):
        check_subject(tmp_path / "nowhere", built_in_body)
    with pytest.raises(InputError, match="no subject's folder"):
        check_subject(tmp_path, built_in_body)


@pytest.mark.parametrize("seed", [1, 2])
def test_a_person_with_usual_noise_has_no_error(seed, tmp_path, built_in_body):
    from gva_mi.synthetic import SynthOptions, make_subject

    options = SynthOptions(
        seed=seed, motion="turn" if seed == 1 else "everyday", frames=6, size=96, samples=1,
        novel_poses=0, novel_views=0,
    )  # fmt: skip
    make_subject(tmp_path / "somebody", options, built_in_body)
    report = check_subject(tmp_path / "somebody", built_in_body).report
    assert not report.errors and report.figures["iou"] > 0.5


def test_the_command_says_writes_and_ends_with_its_code(subject, cli, known_faults):
    out, sheet = subject.parent / "found.json", subject.parent / "sheet.png"
    code, said, err = cli("check", subject)
    assert code == 0, err
    assert "8 frames, 0 errors, 0 doubtful; mean IoU" in said
    known_faults["splits overlap"](subject)
    code, said, err = cli("check", subject, "--json", out, "--sheet", sheet)
    assert code == 1 and "splits overlap" in said and "what to do" in said
    found = json.loads(out.read_text())
    assert [f["what"] for f in found["findings"]] == ["splits overlap"]
    assert found["findings"][0]["frames"] == [2] and found["frames"] == 8
    code, _, err = cli("check", subject, "--json", out)
    assert code == 2 and "--overwrite" in err
    code, _, err = cli("check", Path("nowhere"))
    assert code == 2 and "nowhere: no such folder" in err
    code, said, _ = cli("check", "--help")
    assert "exit code 0" in said.replace("\n", " ")


def test_the_sheet_shows_both_outlines(whole, built_in_body):
    from gva_mi.data.check.sheet import MASK, draw_sheet
    from gva_mi.mesh.overlay import OUTLINE

    checked = check_subject(whole, built_in_body)
    sheet = draw_sheet(checked.contents, checked.compared, built_in_body)
    for color in (MASK, OUTLINE):
        assert (np.abs(sheet - np.float32(color)).max(-1) < 1e-3).sum() > 200
