"""``gva-mi study``: the table says what was found, and cases and rows are chosen by name."""

import json

import pytest

from gva_mi.commands import study as studies
from gva_mi.fit.evaluation import study_report
from gva_mi.fit.evaluation.evaluate import SplitScores
from gva_mi.fit.evaluation.rows import ROWS
from gva_mi.fit.evaluation.study import RowResult
from gva_mi.pose.evaluation.cases import HELD_OUT, TUNING, Case
from gva_mi.pose.evaluation.figures import Change, PoseFigures
from gva_mi.pose.evaluation.study import CaseResult


def figures(before, after):
    return PoseFigures(
        vertices=Change(before, after), hands=Change(before, 2 * before),
        feet=Change(before, after),
        ankles_depth=Change(40.0, -8.0), frames_worse=0.25, iou=Change(0.7, 0.8), iou_truth=0.75,
        seconds_per_frame=1.0,
    )  # fmt: skip


@pytest.fixture
def done(monkeypatch):
    """As if cases were refined at once, each to three quarters less; keeps those that were."""
    computed = []

    def refine(folder, cases, body, options, known, progress, executor):
        there = {(r.case, r.noise): r for r in known}
        for case in cases:
            if (case, 1.0) not in there:
                computed.append(case)
            yield there.get((case, 1.0), CaseResult(case, 1.0, figures(80.0, 20.0)))

    monkeypatch.setattr(studies, "refine_cases", refine)
    monkeypatch.setattr(Case, "lacks", None)
    return computed


def test_the_table_has_a_line_for_each_family_and_the_file_one_for_each_case(done, tmp_path, cli):
    code, out, err = cli("study", "refine", "--out", tmp_path / "new", "--refine.passes", 3)
    assert code == 0, err
    families = list(dict.fromkeys(case.family for case in HELD_OUT))
    lines = out.splitlines()
    head, rows = lines[-4 - len(families)], lines[-3 - len(families) : -1]
    assert head.split()[:5] == ["family", "cases", "body", "hands", "feet"]
    assert [row.split("  ")[0] for row in rows] == [*families, "mean", "worst"]
    assert rows[0].split()[1:8] == ["2", "-75", "%", "+100", "%", "-75", "%"]
    record = json.loads((tmp_path / "new/refine.json").read_text())
    assert [case["name"] for case in record["cases"]] == [case.name for case in HELD_OUT]
    assert record["cases"][0]["figures"]["ankle_depth_mm"] == -8
    assert record["families"]["mean"]["hands"] == pytest.approx(1.0)
    assert record["made_with"]["options"]["refine"]["passes"] == 3 and record["versions"]


def test_people_it_was_tuned_on_are_apart(done, tmp_path, cli):
    for name, cases in (("tuning", TUNING), ("held-out", HELD_OUT), ("all", TUNING + HELD_OUT)):
        done.clear()
        assert cli("study", "refine", "--out", tmp_path / name, "--cases", name)[0] == 0
        assert tuple(done) == cases


def test_a_study_goes_on_where_it_was_cut_short(done, tmp_path, cli):
    lean = ("study", "refine", "--out", tmp_path, "--families", "lean")
    assert cli(*lean)[0] == 0
    first = list(done)
    assert first and {case.family for case in first} == {"lean"}
    code, out, _ = cli("study", "refine", "--out", tmp_path)
    assert f"{len(first)} cases are in" in out and len(done) == len(HELD_OUT)
    done.clear()
    assert cli(*lean)[0] == 0 and not done
    names = [case["name"] for case in json.loads((tmp_path / "refine.json").read_text())["cases"]]
    assert sorted(names) == sorted(case.name for case in HELD_OUT)  # the others are kept
    assert cli(*lean, "--overwrite")[0] == 0 and done == first


def test_people_and_families_are_chosen_by_name(done, tmp_path, cli):
    assert cli("study", "refine", "--out", tmp_path, "--people", "bruno", "13")[0] == 0
    assert {case.take.person for case in done} == {"bruno", "13"}
    for argument, name in (("--people", "amira"), ("--families", "lost")):
        code, _, err = cli("study", "refine", "--out", tmp_path, argument, name)
        assert code == 2 and f"no '{name}'" in err and "in these cases are:" in err
    code, _, err = cli(
        "study", "refine", "--out", tmp_path, "--people", "bruno", "--families", "focal"
    )
    assert code == 2 and "at once" in err


def test_a_case_that_lacks_a_package_is_left_out_with_a_line(done, tmp_path, cli, monkeypatch):
    lacks = property(lambda case: "anny" if case.take.figure == "anny" else None)
    monkeypatch.setattr(Case, "lacks", lacks)
    code, out, _ = cli("study", "refine", "--out", tmp_path, "--families", "mixed")
    assert code == 0 and "for the package anny is not installed" in out
    assert all(case.take.figure != "anny" for case in done) and len(done) == 1


def scored(case, row):
    scores = (SplitScores(row.name, "test", 30.0, 0.97, None, 0.02, "white", 8),)
    return RowResult(case, row.name, scores, (), None, {"lpips": None}, 60.0, 20_000)


@pytest.fixture
def fitted(monkeypatch):
    """As if rows were fitted at once; keeps those that were."""
    computed = []

    def fit(folder, cases, rows, body, options, known, progress, executor):
        there = {(r.case, r.row): r for r in known}
        for case in cases:
            for row in rows:
                if (case, row.name) not in there:
                    computed.append((case, row.name))
                yield there.get((case, row.name)) or scored(case, row)

    monkeypatch.setattr(studies, "fit_rows", fit)
    monkeypatch.setattr(study_report, "sections_of_pictures", lambda runs: [])
    monkeypatch.setattr(Case, "lacks", None)
    return computed


def test_the_avatars_study_has_a_line_for_each_row_and_a_page(fitted, tmp_path, cli):
    avatar = ("study", "avatar", "--out", tmp_path, "--people", "bruno", "edgar")
    code, out, err = cli(*avatar, "--rows", "full", "with residual", "--fit.steps", 600)
    assert code == 0, err
    lines = out.splitlines()
    head = next(k for k, line in enumerate(lines) if line.startswith("row "))
    assert lines[head - 1] == "held-out people: PSNR in dB on white"
    assert lines[head + 1].split()[:4] == ["full", "30.00", "±", "0.00,"]
    assert lines[head + 2].startswith("with residual ") and "(+0.00)" in lines[head + 2]
    record = json.loads((tmp_path / "avatar.json").read_text())
    assert {r["row"] for r in record["results"]} == {"full", "with residual"}
    assert record["made_with"]["options"]["fit"]["steps"] == 600
    page = (tmp_path / "avatar.html").read_text()
    assert "Table 4: ablation" in page and "bruno: bursts 1000" in page and "held out" in page


def test_the_avatars_study_goes_on_where_it_was_cut_short(fitted, tmp_path, cli):
    avatar = ("study", "avatar", "--out", tmp_path, "--cases", "tuning", "--families", "white")
    avatar += ("--people", "dalia")
    assert cli(*avatar, "--rows", "full")[0] == 0
    assert [row for _, row in fitted] == ["full"]
    code, out, _ = cli(*avatar)
    assert code == 0 and "1 rows are in" in out and len(fitted) == len(ROWS)
    assert "people it was tuned on" in out
    fitted.clear()
    assert cli(*avatar)[0] == 0 and not fitted
    run = tmp_path / "runs/dalia-white-3/full"
    run.mkdir(parents=True)
    assert cli(*avatar, "--rows", "full", "--overwrite")[0] == 0 and len(fitted) == 1
    assert not run.exists()  # or its avatar would be taken for the new one
    kept = json.loads((tmp_path / "avatar.json").read_text())["results"]
    assert [r["row"] for r in kept] == [row.name for row in ROWS]  # the others are kept


def test_a_row_is_chosen_by_its_name(fitted, tmp_path, cli):
    code, _, err = cli("study", "avatar", "--out", tmp_path, "--rows", "best")
    assert code == 2 and "no 'best'; there are: full, " in err and not fitted
