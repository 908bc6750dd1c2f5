"""The study's table: people count once, and those who judge are never mixed with the others."""

import json
from dataclasses import replace

import pytest

from gva_mi.errors import InputError
from gva_mi.fit.evaluation.evaluate import SplitScores
from gva_mi.fit.evaluation.metrics import ALIGNED
from gva_mi.fit.evaluation.paper import TABLES
from gva_mi.fit.evaluation.rows import ROWS
from gva_mi.fit.evaluation.study import RowResult
from gva_mi.fit.evaluation.study_file import load_results, save_results
from gva_mi.fit.evaluation.study_report import table
from gva_mi.fit.evaluation.summary import COLUMNS, PSNR, figure, summaries
from gva_mi.fit.evaluation.surface_figures import SurfaceFigures
from gva_mi.pose.evaluation.cases import HELD_OUT, TUNING

BRUNO = [case for case in HELD_OUT if case.take.person == "bruno"]
EDGAR = [case for case in HELD_OUT if case.take.person == "edgar"]
TEST = PSNR[0]


def result(case, row, psnr, novel=20.0):
    scores = (
        SplitScores(row, "test", psnr, 0.9, None, 0.03, "white", 8),
        SplitScores(row, "test", psnr - 5, 0.8, None, 0.05, "hands", 8),
        SplitScores(ALIGNED, "novel_pose", novel, 0.8, None, 0.05, "white", 8),
    )
    surface = (SurfaceFigures(300, "end", 4000, {"all": 0.3}, {"hair": 9.0}),)
    return RowResult(case, row, scores, surface, {"scale": 1.02}, {"lpips": None}, 60.0, 20_000)


RESULTS = [
    result(BRUNO[0], "full", 30.0), result(BRUNO[1], "full", 32.0),
    result(EDGAR[0], "full", 28.0), result(TUNING[0], "full", 99.0),
    result(BRUNO[0], "with residual", 29.0), result(EDGAR[0], "with residual", 26.0),
]  # fmt: skip


def held_out(results):
    return [r for r in results if r.case in HELD_OUT]


def test_a_person_counts_once_however_many_noises_there_are():
    found = figure(held_out(RESULTS), "full", TEST)
    assert (found.mean, found.spread, found.worst, found.people) == (29.5, 1.5, 28.0, 2)


def test_differences_are_those_of_the_same_case():
    """Of Bruno one case has both rows: 29 - 30, and not 29 minus the mean of his two."""
    found = figure(held_out(RESULTS), "with residual", TEST)
    assert found.against_full == pytest.approx(((29 - 30) + (26 - 28)) / 2)
    assert figure(RESULTS[-1:], "with residual", TEST).against_full is None


def test_people_it_was_tuned_on_are_apart():
    found = summaries(RESULTS)
    assert list(found) == ["held-out people", "people it was tuned on"]
    assert found["people it was tuned on"]["full"][TEST.name].mean == 99
    assert list(summaries(held_out(RESULTS))) == ["held-out people"]


def test_columns_have_names_of_their_own_and_find_their_figures():
    assert len({column.name for column in COLUMNS}) == len(COLUMNS)
    values = {column.name: column.of(RESULTS[0]) for column in COLUMNS}
    assert values["psnr: test"] == 30 and values["psnr: test, hands"] == 25
    assert values["psnr: novel pose, aligned"] == 20 and values["psnr: novel pose"] is None
    assert values["spacing at the end"] == 0.3 and values["bias of hair at the end, mm"] == 9
    assert values["seconds"] == 60 and values["lpips: test"] is None


def test_the_table_leaves_out_what_nobody_has():
    made = table(held_out(RESULTS), PSNR)
    assert made.head == ("row", "test", "novel pose, aligned")
    assert made.rows[0] == ["full", "29.50 ± 1.50, worst 28.00", "20.00 ± 0.00, worst 20.00"]
    assert made.rows[1] == [
        "with residual",
        "27.50 ± 1.50, worst 26.00 (-1.50)",
        "20.00 ± 0.00, worst 20.00 (+0.00)",
    ]


def test_the_file_keeps_results_as_long_as_they_hold(tmp_path):
    path, made = tmp_path / "avatar.json", {"sources": "a"}
    save_results(path, RESULTS[:2], made, RESULTS[2:])
    assert load_results(path, made) == RESULTS
    assert load_results(path, {"sources": "b"}) == []
    assert load_results(tmp_path / "none.json", made) == []
    record = json.loads(path.read_text())
    assert [r["held_out"] for r in record["results"]] == [r.case in HELD_OUT for r in RESULTS]
    assert record["summary"]["held-out people"]["full"][TEST.name]["people"] == 1
    assert record["paper"][3]["title"].startswith("Table 4")
    path.write_text("[]")
    with pytest.raises(InputError, match="avatar.json: of another form.*--overwrite"):
        load_results(path, made)


def test_a_figure_that_is_missing_in_a_file_is_none(tmp_path):
    bare = replace(RESULTS[0], surface=(), similarity=None)
    save_results(tmp_path / "a.json", [bare], {})
    assert load_results(tmp_path / "a.json", {}) == [bare]


def test_the_papers_ablation_names_rows_that_there_are():
    rows = {row.name for row in ROWS}
    for line in TABLES[3].rows:
        assert set(line[-1].split("; ")) <= rows
    for paper in TABLES:
        assert all(len(line) == len(paper.head) for line in paper.rows)
