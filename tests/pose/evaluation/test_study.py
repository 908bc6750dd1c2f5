"""The study's protocol."""

import math

import pytest
import torch

from gva_mi.data.synthetic import STUDY
from gva_mi.pose import SequenceOptions
from gva_mi.pose.evaluation.measure import REGIONS, Measured, VertexErrors
from gva_mi.pose.evaluation.study import HELD_OUT, TUNING, CaseResult, StudyOptions, study


def test_nobody_is_both_tuned_on_and_judged():
    who = lambda case: (case.subject, case.seed if case.subject is None else None)
    assert not {who(case) for case in TUNING} & {who(case) for case in HELD_OUT}
    assert not {case.name for case in TUNING} & {case.name for case in HELD_OUT}
    for cases in (TUNING, HELD_OUT):
        assert any(case.bare for case in cases) and any(not case.bare for case in cases)
        assert all(case.subject in (None, *STUDY) for case in cases)


def test_changes_are_relative_to_stage_1():
    errors = lambda value: VertexErrors(*[torch.full((4,), value)] * 6)
    iou = torch.ones(4)
    row = CaseResult(
        HELD_OUT[0], 1.0, Measured(errors(80.0), errors(20.0), iou, iou, iou, iou, 1.0)
    )
    assert row.change == dict.fromkeys(REGIONS, -0.75)
    exact = CaseResult(
        HELD_OUT[0], 0.0, Measured(errors(0.0), errors(1.0), iou, iou, iou, iou, 1.0)
    )
    assert all(math.isnan(change) for change in exact.change.values())


@pytest.mark.slow
def test_a_small_study_runs_and_keeps_its_subjects(tmp_path, body):
    options = StudyOptions(frames=3, size=48, refine=SequenceOptions(size=48, passes=2))
    calls = []
    (row,) = study(tmp_path, TUNING[-1:], body, options, lambda *a: calls.append(a))
    assert set(row.stage1_mm) == set(REGIONS) and row.measured.refined.body.shape == (3,)
    assert calls == [(1, 1)] and len(list(tmp_path.iterdir())) == 1
    (again,) = study(tmp_path, TUNING[-1:], body, options)
    assert again.refined_mm == row.refined_mm
