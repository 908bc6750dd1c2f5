"""Subjects count once, error models count once, and tuned subjects are never mixed with others."""

import pytest

from gva_mi.study.cases import HELD_OUT, TUNING, StudyCase, Take
from gva_mi.study.engine import Outcome
from gva_mi.study.measure import PoseFigures
from gva_mi.study.refine_study import columns
from gva_mi.study.tables import avatar_cells, cell, refine_cells

BRUNO = [case for case in HELD_OUT if case.take.person == "bruno"]
EDGAR = [case for case in HELD_OUT if case.take.person == "edgar"]
TEST = "psnr: test"


def outcome(case, variant, psnr):
    figures = {TEST: psnr, "psnr in boxes: test, hands": psnr - 5, "lpips: test": None}
    return Outcome(case, variant, figures | {"cost: seconds": 60.0, "text": "not in a table"})


OUTCOMES = [
    outcome(BRUNO[0], "full", 30.0), outcome(BRUNO[1], "full", 32.0),
    outcome(EDGAR[0], "full", 28.0), outcome(TUNING[0], "full", 99.0),
    outcome(BRUNO[0], "with residual", 29.0), outcome(EDGAR[0], "with residual", 26.0),
]  # fmt: skip


def test_a_subject_counts_once_however_many_errors_are_drawn():
    found = cell(OUTCOMES[:3], TEST)
    assert (found.mean, found.std, found.worst, found.subjects) == (29.5, 1.5, 28.0, 2)
    assert cell(OUTCOMES, "lpips: test") is None


def test_differences_are_those_of_the_same_case():
    """Of Bruno one case has both variants: 29 - 30, and not 29 minus the mean of his two."""
    found = cell(OUTCOMES[4:], TEST, OUTCOMES[:4])
    assert found.against_full == pytest.approx(((29 - 30) + (26 - 28)) / 2)
    assert cell(OUTCOMES[4:], TEST).against_full is None


def test_subjects_of_the_tuning_set_are_apart():
    found = avatar_cells(OUTCOMES[::-1])
    assert list(found) == ["held-out subjects", "subjects of the tuning set"]
    assert found["subjects of the tuning set"]["full"][TEST].mean == 99
    assert found["held-out subjects"]["full"][TEST].mean == 29.5


def refinement(error_model, draw, after, ankles=0.0, **others):
    """An outcome whose body error was 100 mm at stage 1."""
    figures = {"vertex_mm_stage1": 100.0, "vertex_mm": after, "ankle_depth_mm": ankles, **others}
    found = PoseFigures.from_json(figures)
    case = StudyCase(Take(seed=draw), error_model, draw)
    return Outcome(case, "refined", columns(found) | found.to_json())


def test_an_error_model_counts_once_however_many_cases_it_has():
    white = [refinement("white", k, after) for k, after in enumerate((10.0, 20.0, 30.0))]
    rows = refine_cells([*white, refinement("lean", 9, 60.0)])["error models"]
    assert list(rows) == ["white", "lean", "mean", "worst"]
    changes = [row["change: body"].mean for row in rows.values()]
    assert changes == pytest.approx([-0.8, -0.4, -0.6, -0.4])
    assert rows["white"]["change: body"].subjects == 3


def test_the_worst_depth_is_the_farthest_off_and_the_worst_iou_the_lowest():
    some = [
        refinement("white", 1, 1.0, ankles=10.0, iou=0.7, iou_truth=0.8),
        refinement("lean", 2, 1.0, ankles=-30.0, iou=0.85, iou_truth=0.8),
    ]
    rows = refine_cells(some)["error models"]
    assert [row["depth: ankles, mm"].mean for row in rows.values()] == [10, -30, -10, -30]
    assert rows["worst"]["iou: IoU - limit"].mean == pytest.approx(-0.1)
