"""A study runs, keeps what it made, and goes on where it was cut short."""

from dataclasses import replace

import numpy as np
import pytest

from gva_mi.data.truth import load_truth
from gva_mi.data.video import load_video
from gva_mi.errors import InputError
from gva_mi.pose import SequenceOptions
from gva_mi.pose.evaluation import study as studies
from gva_mi.pose.evaluation import study_file
from gva_mi.pose.evaluation.cases import TUNING
from gva_mi.pose.evaluation.figures import Change, PoseFigures
from gva_mi.pose.evaluation.study import (
    CaseResult,
    StudyOptions,
    height_of,
    study,
    through_lens_of,
)
from gva_mi.pose.evaluation.study_file import load_study, save_study
from gva_mi.pose.evaluation.subjects import Filming
from gva_mi.pose.stature import Stature


def result(case, noise=1.0, after=20.0):
    return CaseResult(case, noise, PoseFigures(vertices=Change(80.0, after), iou_truth=0.8))


def test_results_come_back_from_their_file(body, tmp_path):
    path, options = tmp_path / "refine.json", StudyOptions()
    assert load_study(path, body, options) == []
    results = [result(case, after=k) for k, case in enumerate(TUNING)]
    save_study(path, results[:2], body, options, results[2:])
    assert load_study(path, body, options) == results
    more_noise = replace(options, noise=(1.0, 2.0))  # is said of each result
    assert load_study(path, body, more_noise) == results


def test_results_hold_for_the_same_options_body_and_program_alone(body, tmp_path, monkeypatch):
    path, options = tmp_path / "refine.json", StudyOptions()
    save_study(path, [result(TUNING[0])], body, options)
    for other in (
        replace(options, frames=32),
        replace(options, refine=SequenceOptions(passes=1 + options.refine.passes)),
    ):
        assert load_study(path, body, other) == []
    fewer = body.on(range(0, len(body.v_template), 2), body.faces[:0])
    assert load_study(path, fewer, options) == []
    monkeypatch.setattr(study_file, "program_digest", lambda: "another program")
    assert load_study(path, body, options) == []


def test_a_file_that_is_none_is_named(body, tmp_path):
    (tmp_path / "refine.json").write_text("{")
    with pytest.raises(InputError, match="refine.json: not readable.*--overwrite"):
        load_study(tmp_path / "refine.json", body, StudyOptions())


def test_what_is_known_is_not_computed_again(body, tmp_path, monkeypatch):
    made = []

    def refined(folder, case, noise, *others):
        made.append((case, noise))
        return result(case, noise)

    monkeypatch.setattr(studies, "_refined", refined)
    options, cases = StudyOptions(noise=(1.0, 2.0)), TUNING[:2]
    known = [result(cases[1], 1.0, after=5.0), result(TUNING[-1])]
    calls = []
    found = list(study(tmp_path, cases, body, options, known, lambda *counts: calls.append(counts)))
    assert made == [(cases[0], 1.0), (cases[0], 2.0), (cases[1], 2.0)]
    assert found[1] is known[0] and [r.noise for r in found] == [1, 1, 2, 2]
    assert calls == [(1, 4), (2, 4), (3, 4), (4, 4)]


@pytest.mark.slow
def test_a_small_study_runs_and_keeps_its_subjects(tmp_path, body):
    options = StudyOptions(frames=3, size=48, refine=SequenceOptions(size=48, passes=2))
    bare = [case for case in TUNING if case.take.bare]
    two = [bare[0], replace(bare[0], noise="white", draw=50, normals=False)]
    first, second = study(tmp_path, two, body, options)
    assert first.figures.points == "vertices" and first.figures.fingers.stage1 > 0
    assert first.figures.vertices.stage1 != second.figures.vertices.stage1
    assert [len(list((tmp_path / name).iterdir())) for name in ("takes", "videos")] == [1, 2]
    (again,) = study(tmp_path, two[:1], body, options)
    assert replace(again.figures, seconds_per_frame=None) == replace(
        first.figures, seconds_per_frame=None
    )


@pytest.mark.slow
def test_a_figure_that_is_not_the_fitted_body_is_judged_by_joints(tmp_path, body):
    options = StudyOptions(frames=2, size=48, refine=SequenceOptions(size=48, passes=1))
    stretched = [case for case in TUNING if case.take.figure == "stretched"]
    (found,) = study(tmp_path, stretched[:1], body, options)
    assert found.figures.points == "joints"
    assert 0 < found.figures.surface.stage1 < found.figures.vertices.stage1


@pytest.mark.slow
def test_a_study_that_is_told_height_and_lens_puts_people_where_they_are(tmp_path, body):
    options = StudyOptions(frames=3, size=48, refine=SequenceOptions(size=48, passes=1), told=True)
    bare = next(case for case in TUNING if case.take.bare)
    case = replace(bare, noise="focal", draw=51)
    video = load_video(Filming(tmp_path, 3, 48).film(case, body))
    truth = load_truth(video.truth, body)
    told = through_lens_of(truth, video, body)
    focal, right = (v.cameras[0].fx / truth.cameras[0].fx for v in (video, told))
    assert abs(focal - 1) > 0.03 and right == pytest.approx(1)
    pelvis = [v.pose.transl + body.rest(v.shape).joints[0] for v in (video, told)]
    seen = [v.cameras[0].project(p.numpy()) for v, p in zip((video, told), pelvis, strict=True)]
    np.testing.assert_allclose(seen[1], seen[0], atol=1e-3)
    assert height_of(truth) == pytest.approx(float(Stature.of(body).height(truth.shape)), abs=0.01)
    (found,) = study(tmp_path, [case], body, options)
    assert found.figures.focal.refined < 1e-6 < 0.03 < found.figures.focal.stage1
    depth = found.figures.pelvis_depth
    assert abs(depth.refined) < 0.5 * abs(depth.stage1)
