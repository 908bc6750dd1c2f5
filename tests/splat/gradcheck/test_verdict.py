"""The rule is one number per row: nothing excuses an error beyond it."""

import json
from dataclasses import replace

import numpy as np
import pytest

from gva_mi.splat.gradcheck.verdict import Comparison, Maps, Report, write_json, write_picture


def row(method="adjoint f32", error=1e-7):
    return Comparison(method, "means", error, 1.0, 1e-9, (3, 1), tolerance=1e-5)


def report(*rows, notes=()):
    maps = Maps(np.full((4, 5, 3), 0.5), np.full((4, 5), 1e-7), np.eye(4, 5) > 0)
    return Report(rows, 20, 4, 2e-3, 7, {"means": 1e-4}, notes, maps)


def test_an_error_beyond_its_tolerance_fails():
    assert row(error=1e-5).passed
    assert not row(error=1.0001e-5).passed
    assert not row(error=float("nan")).passed
    # however far the truth moves with the inputs' last digit
    assert not report(row(error=2e-5)).passed


def test_lost_digits_are_told_from_mistakes():
    assert "all 2 comparisons pass" in report(row(), row()).verdict
    assert "less accurate than allowed: adjoint f32 of means" in report(row(error=1e-4)).verdict
    assert "WRONG: adjoint f32 of means" in report(row(error=0.1)).verdict
    assert "WRONG" in report(row("adjoint f64", 1e-4)).verdict


def test_another_picture_is_told_before_its_gradients():
    image = replace(row(error=0.1), name="color")
    found = report(row(error=0.1), image, replace(image, method="adjoint f64")).verdict
    assert "WRONG: your image differs in color; adjoint f32 of means, adjoint f32 of color" in found
    # lost digits make no other picture
    assert "image" not in report(replace(image, error=1e-4)).verdict


def test_the_table_marks_what_fails_and_counts_what_was_left_out():
    table = report(row(), row("tangent f32", 1e-4), notes=("no float64",)).table()
    (failed,) = [line for line in table.splitlines() if "FAILS" in line]
    assert failed.startswith("tangent f32") and "[3, 1]" in failed
    assert "4 at a step were left out (off by 2e-03)" in table
    assert "means 1e-04" in table and "no float64" in table


def test_json_holds_every_row(tmp_path):
    reports = {"a": report(row()), "b": report(row(), row(error=1.0))}
    write_json(reports, tmp_path / "report.json")
    figures = json.loads((tmp_path / "report.json").read_text())
    assert not figures["passed"] and figures["scenes"]["a"]["passed"]
    assert [r["passed"] for r in figures["scenes"]["b"]["rows"]] == [True, False]
    assert figures["scenes"]["a"]["rows"][0]["where"] == [3, 1]


def test_the_picture_is_written(tmp_path):
    pytest.importorskip("matplotlib")
    grey = replace(report(row()), maps=Maps(np.ones((4, 5, 1)), np.ones((4, 5)), np.eye(4, 5) > 0))
    write_picture({"color": report(row()), "one channel": grey}, tmp_path / "report.png")
    assert (tmp_path / "report.png").stat().st_size > 1000
