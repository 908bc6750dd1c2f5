"""One number per comparison decides, and nothing excuses an error beyond it."""

import json
from dataclasses import replace

import numpy as np

from gva_mi.gradcheck.engine import Comparison, Report, write_reports
from gva_mi.gradcheck.splat import Maps, RendererReport


def row(method="adjoint f32", error=1e-7):
    return Comparison(method, "means", error, 1e-9, (3, 1), tolerance=1e-5)


def report(*rows, notes=()):
    maps = Maps(np.full((4, 5, 3), 0.5), np.full((4, 5), 1e-7), np.eye(4, 5) > 0)
    return RendererReport(rows, "a scene", notes, 20, 4, 7, {"means": 1e-4}, maps)


def test_an_error_beyond_its_tolerance_fails():
    assert row(error=1e-5).passed
    assert not row(error=1.0001e-5).passed
    assert not row(error=float("nan")).passed
    # however far the true gradient moves with the inputs' last digit
    assert not report(row(error=2e-5)).passed


def test_lost_digits_are_distinguished_from_mistakes():
    assert "all 2 comparisons pass (a scene)" in report(row(), row()).verdict
    assert "less accurate than allowed: adjoint f32 of means" in report(row(error=1e-4)).verdict
    assert "WRONG: adjoint f32 of means" in report(row(error=0.1)).verdict
    assert "WRONG" in report(row("adjoint f64", 1e-4)).verdict


def test_a_different_image_is_named_before_its_gradients():
    image = replace(row(error=0.1), name="color")
    found = report(row(error=0.1), image, replace(image, method="adjoint f64")).verdict
    assert "WRONG: your image differs in color; adjoint f32 of means; adjoint f32, " in found
    assert "image" not in report(replace(image, error=1e-4)).verdict  # lost digits alone


def test_json_holds_every_comparison(tmp_path):
    plain = Report((row(), row(error=1.0)), "an avatar")
    write_reports({"a": report(row()), "b": plain}, tmp_path / "report.json")
    figures = json.loads((tmp_path / "report.json").read_text())
    assert not figures["passed"] and figures["scenes"]["a"]["passed"]
    assert [r["passed"] for r in figures["scenes"]["b"]["rows"]] == [True, False]
    assert figures["scenes"]["a"]["rows"][0]["where"] == [3, 1]
