"""A good folder has no problem; each fault is named, as far as files and silhouettes show it."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from samples.broken_cases import arrays, poses
from samples.faults import FAULTS, longer, masks

from gva_mi import InputError
from gva_mi.app import steps
from gva_mi.mesh.overlay import OUTLINE
from gva_mi.subject.check import check_subject
from gva_mi.subject.problems import CheckReport, doubt
from gva_mi.subject.silhouettes import MASK_COLOR, draw_sheet, sanity_check
from gva_mi.subject.video import load_video

QUICK = {  # one of each kind
    "T_camera_world is inverted", "cameras in millimetres", "K is of another picture size",
    "focal length 1.5 times too long", "full masks", "normals of another size", "betas",
    "poses of fewer frames", "pictures of another size", "two files cut short",
    "K with a skew",
}  # fmt: skip


def whats(report):
    return {problem.what for problem in report.problems}


def test_a_good_folder_has_no_problem(whole, built_in_body):
    report = check_subject(whole, built_in_body)
    assert not report.problems and not report.skipped
    assert report.figures["iou"] > 0.95 and report.figures["joints_inside"] > 0.95


@pytest.mark.parametrize(
    "name", [pytest.param(x, marks=() if x in QUICK else pytest.mark.slow) for x in FAULTS]
)
def test_a_fault_is_named(name, subject, built_in_body):
    expected, change = FAULTS[name]
    change(subject)
    report = check_subject(subject, built_in_body)
    assert whats(report) == expected
    first = report.problems[0]
    assert first.severity == "error" and first.figure and first.cause and first.remedy


def test_several_faults_are_named_in_one_pass(subject, built_in_body):
    some = [FAULTS[name] for name in ("inverted masks", "splits", "T_camera_world is inverted")]
    for _, change in some:
        change(subject)
    report = check_subject(subject, built_in_body)
    assert set.union(*(expected for expected, _ in some)) <= whats(report)
    assert report.problems == sorted(report.problems, key=lambda p: p.severity != "error")


def test_frames_with_another_person_or_without_a_mask_are_listed(subject, built_in_body):
    away = np.float32(1.2) * (np.arange(8) == 5)[:, None]
    poses(transl=lambda x: x + away)(subject)
    (subject / "masks/000002.png").unlink()
    report = check_subject(subject, built_in_body)
    found = {problem.what: problem for problem in report.problems}
    assert not report.errors and found["frames left out"].frames == (2,)
    assert found["poses outside the masks"].frames == (5,)


def test_a_lost_person_of_a_video_is_told_once(monkeypatch):
    lost = doubt("person not found", "2 of 4 frames", "", "", (1, 2))
    monkeypatch.setattr(steps, "body_of", lambda *_: None)
    monkeypatch.setattr(steps, "_filmed", lambda *_: [lost])
    for frames, told in (((1, 2), [lost.what]), ((1, 2, 3), [lost.what, "frames left out"])):
        report = CheckReport(4, [doubt("frames left out", "", "", "", frames)])
        monkeypatch.setattr(steps, "check_subject", lambda *_, report=report: report)
        assert [problem.what for problem in steps.check("subject").problems] == told


def test_a_folder_for_another_body_is_named(subject, built_in_body):
    about = {"name": "SMPLX_MALE", "vertices": 10475, "sketch": [0.0] * 32}
    (subject / "prepare.json").write_text(json.dumps({"body": about}))
    report = check_subject(subject, built_in_body)
    assert "SMPLX_MALE" in next(p for p in report.problems if p.what == "another body").figure


def test_what_is_no_subject_cannot_be_checked(tmp_path, built_in_body):
    with pytest.raises(InputError, match="no such folder"):
        check_subject(tmp_path / "nowhere", built_in_body)
    with pytest.raises(InputError, match="no subject's folder"):
        check_subject(tmp_path, built_in_body)


def test_the_command_prints_writes_and_ends_with_its_code(subject, cli):
    sheet = subject.parent / "sheet.png"
    assert "8 frames, 0 errors, 0 doubtful; mean IoU" in cli.works("check", subject)
    FAULTS["splits"][1](subject)
    code, said, err = cli("check", subject, "--sheet", sheet)
    assert code == 1 and "splits" in said and "what to do" in said
    assert sheet.stat().st_size
    assert "--overwrite" in cli.fails("check", subject, "--sheet", sheet)
    assert "nowhere: no such folder" in cli.fails("check", Path("nowhere"))


def test_the_sheet_shows_both_outlines(whole, built_in_body):
    sheet = draw_sheet(load_video(whole), built_in_body)
    for color in (MASK_COLOR, OUTLINE):
        assert (np.abs(sheet - np.float32(color)).max(-1) < 1e-3).sum() > 200


def test_clothes_and_an_estimators_errors_are_no_error(tmp_path, built_in_body):
    """A clothed synthetic subject with the mixed error model, and the same with another focal."""
    from gva_mi.synthetic import SynthOptions, make_subject

    options = SynthOptions(seed=61, motion="walk", error_model="mixed", frames=16, size=128,
        samples=1, novel_poses=0, novel_views=0)  # fmt: skip
    make_subject(tmp_path / "walker", options, built_in_body)
    assert not check_subject(tmp_path / "walker", built_in_body).errors
    longer(1.5)(tmp_path / "walker")
    assert "focal length or distance" in whats(check_subject(tmp_path / "walker", built_in_body))


# The quick check before hours of work.


def cut(subject, top, bottom):
    """Crop every picture to what lies between two shares of its height."""
    cameras = arrays(subject / "cameras.npz")
    height = int(cameras["height"])
    first, last = round(top * height), round(bottom * height)
    for path in (*subject.glob("frames/*.png"), *subject.glob("masks/*.png")):
        picture = Image.open(path)
        picture.crop((0, first, picture.width, last)).save(path)
    cameras["height"] = np.array(last - first)
    cameras["K"][..., 1, 2] -= first
    np.savez(subject / "cameras.npz", **cameras)


def far_away(subject):
    """All joints of a person a kilometre away lie in the masks, in one pixel of them."""
    cameras = arrays(subject / "cameras.npz")
    masks(lambda mask: np.pad(np.full_like(mask[10:-10, 10:-10], 255), 10))(subject)
    cameras["K"][..., :2, 2] = cameras["width"] / 2, cameras["height"] / 2
    cameras["T_camera_world"][..., 2, 3] += 1000
    np.savez(subject / "cameras.npz", **cameras)


def turned(quarters):
    """As a video that lost its rotation: all pictures, and the camera, turned counter-clockwise."""

    def turn(subject):
        shutil.rmtree(subject / "normals", ignore_errors=True)
        for path in (*subject.glob("frames/*.png"), *subject.glob("masks/*.png")):
            picture = np.rot90(np.asarray(Image.open(path)), quarters)
            Image.fromarray(np.ascontiguousarray(picture)).save(path)
        for _ in range(quarters):
            cameras = arrays(subject / "cameras.npz")
            K, width = cameras["K"].copy(), int(cameras["width"])
            cameras["K"][..., 0, 0], cameras["K"][..., 1, 1] = K[..., 1, 1], K[..., 0, 0]
            cameras["K"][..., 0, 2], cameras["K"][..., 1, 2] = K[..., 1, 2], width - K[..., 0, 2]
            left = np.eye(4)[[1, 0, 2, 3]] * [[1], [-1], [1], [1]]  # x' = y, y' = -x
            cameras["T_camera_world"] = left @ cameras["T_camera_world"]
            cameras["width"], cameras["height"] = cameras["height"], cameras["width"]
            np.savez(subject / "cameras.npz", **cameras)

    return turn


@pytest.mark.parametrize("quarters", [1, 2, 3])
def test_pictures_that_are_not_upright_are_doubtful(quarters, subject, built_in_body):
    turned(quarters)(subject)
    (problem,) = check_subject(subject, built_in_body).problems
    assert problem.severity == "doubtful" and problem.what == "rotation"
    assert ("head down" if quarters == 2 else "on the side") in problem.figure


DOUBTS = {  # what is done to the folder, and the doubt
    "cut off at the hips": (lambda folder: cut(folder, 0.0, 0.55), None),
    "cut off below the arms": (lambda folder: cut(folder, 0.0, 0.4), None),
    "hardly in the picture": (
        lambda folder: cut(folder, 0.68, 1.0), "of the body's joints lie in the picture"),
    "far away": (far_away, "0% of the body and of the masks is in both"),
    "inverted masks": (FAULTS["inverted masks"][1], "100% of the masks show the background"),
    "upside down": (turned(2), "head down, as in a video that lost its rotation"),
    "on the side": (turned(1), "on the side, as in a video that lost its rotation"),
}  # fmt: skip


@pytest.mark.parametrize("name", DOUBTS)
def test_the_sanity_check_doubts_a_body_that_is_elsewhere(name, subject, built_in_body):
    change, expected = DOUBTS[name]
    change(subject)
    found = sanity_check(load_video(subject, normals="none"), built_in_body)
    if expected is None:
        assert found is None
    else:
        assert expected in found and str(subject) in found
