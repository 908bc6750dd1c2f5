"""The table: cases make families, families make the mean."""

import math

import pytest

from gva_mi.pose.evaluation.cases import Case, Take
from gva_mi.pose.evaluation.figures import Change, PoseFigures
from gva_mi.pose.evaluation.study import CaseResult
from gva_mi.pose.evaluation.summary import COLUMNS, rows_of


def result(family, draw, after, ankles=0.0, noise=1.0, **figures):
    """A case whose body error was 100 mm."""
    found = PoseFigures(
        vertices=Change(100.0, after), ankles_depth=Change(-50.0, ankles), iou_truth=0.8, **figures
    )
    return CaseResult(Case(Take(seed=draw), family, draw), noise, found)


def value(row, name):
    return row.values[[column.name for column in COLUMNS].index(name)]


def test_a_family_counts_once_however_many_cases_it_has():
    white = [result("white", k, after) for k, after in enumerate((10.0, 20.0, 30.0))]
    rows = rows_of([*white, result("lean", 9, 60.0)])
    assert [(row.name, row.cases) for row in rows] == [
        ("white", 3), ("lean", 1), ("mean", 4), ("worst", 4),
    ]  # fmt: skip
    changes = [value(row, "body") for row in rows]
    assert changes == pytest.approx([-0.8, -0.4, -0.6, -0.4])


def test_depths_keep_their_sign_and_the_worst_is_the_farthest_off():
    rows = rows_of([result("white", 1, 1.0, ankles=10.0), result("lean", 2, 1.0, ankles=-30.0)])
    assert [value(row, "ankles, mm") for row in rows] == [10, -30, -10, -30]


def test_the_worst_iou_is_the_lowest_against_that_of_the_truth():
    rows = rows_of([result("a", k, 1.0, iou=Change(0.5, iou)) for k, iou in ((1, 0.7), (2, 0.85))])
    assert value(rows[-1], "IoU - truth's") == pytest.approx(-0.025)  # one family: its mean
    apart = rows_of(
        [result(f, 1, 1.0, iou=Change(0.5, iou)) for f, iou in (("a", 0.7), ("b", 0.85))]
    )
    assert value(apart[-1], "IoU - truth's") == pytest.approx(-0.1)


def test_what_is_not_known_is_left_out_and_not_counted_as_nothing():
    without = result("white", 1, 40.0)
    rows = rows_of([without, result("white", 2, 40.0, hands=Change(10.0, 5.0))])
    assert value(rows[0], "hands") == -0.5 and math.isnan(value(rows[0], "fingers"))
    exact = result("white", 3, 1.0, feet=Change(0.0, 1.0))  # nothing to change: no share of it
    assert all(math.isnan(value(row, "feet")) for row in rows_of([exact]))
    assert rows_of([exact])[0].to_json()["feet"] is None


def test_levels_of_noise_are_apart():
    rows = rows_of([result("white", 1, 50.0, noise=level) for level in (1.0, 2.0)])
    assert [row.name for row in rows[:2]] == ["white, noise 1", "white, noise 2"]


def test_cells_are_written_for_people():
    cells = dict(zip(("", "cases", *(c.name for c in COLUMNS)), rows_of(
        [result("white", 1, 31.0, ankles=-7.6, frames_worse=0.125, seconds_per_frame=1.5)]
    )[0].cells(), strict=True))  # fmt: skip
    assert cells[""] == "white" and cells["cases"] == "1"
    assert cells["body"] == "-69 %" and cells["ankles, mm"] == "-8" and cells["worse"] == "12 %"
    assert cells["s a frame"] == "1.50" and cells["fingers"] == ""
