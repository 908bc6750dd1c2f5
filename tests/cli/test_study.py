"""``gva-mi study``: cases are chosen by name, results are kept, tables say what was found."""

import json
from dataclasses import dataclass
from typing import Any

import pytest

from gva_mi.study import avatar_study, refine_study
from gva_mi.study.cases import HELD_OUT, LIMITS, StudyCase
from gva_mi.study.measure import PoseFigures
from gva_mi.study.variants import VARIANTS

FIGURES = PoseFigures.from_json({
    "vertex_mm_stage1": 80.0, "vertex_mm": 20.0, "hand_vertex_mm_stage1": 80.0,
    "hand_vertex_mm": 160.0, "ankle_depth_mm_stage1": 40.0, "ankle_depth_mm": -8.0,
    "frames_worse": 0.25, "iou_stage1": 0.7, "iou": 0.8, "iou_truth": 0.75,
})  # fmt: skip


@dataclass
class Work:
    """As if a case were computed at once."""

    figures: dict[str, Any]
    log: list
    pair: tuple
    steps: int = 1

    def solve(self, progress=None):
        self.log.append(self.pair)
        return self.figures


@pytest.fixture
def done(monkeypatch):
    """Cases and variants that were computed, in their order."""
    log = []
    refined = refine_study.columns(FIGURES) | FIGURES.to_json()
    fitted = {"psnr: test": 30.0, "cost: seconds": 60.0}
    for study, figures in (
        (refine_study.RefineStudy, refined),
        (avatar_study.AvatarStudy, fitted),
    ):
        rounds = lambda self, missing, f=figures: [[Work(f, log, pair) for pair in missing]]
        monkeypatch.setattr(study, "rounds", rounds)
    monkeypatch.setattr(StudyCase, "lacks", None)
    return log


def test_the_refinements_table_has_a_row_for_each_error_model(done, tmp_path, cli):
    out = cli.works("study", "refine", "--out", tmp_path / "new", "--refine.passes", 3)
    families = list(dict.fromkeys(case.kind_of_errors for case in HELD_OUT))
    lines = out.splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith("error model "))
    head, rows = lines[start], lines[start + 1 : start + 3 + len(families)]
    assert head.split()[:4] == ["error", "model", "body", "hands"]
    assert [row.split("  ")[0] for row in rows] == [*families, "mean", "worst"]
    assert rows[0].split()[1:5] == ["-75", "%", "+100", "%"]
    record = json.loads((tmp_path / "new/refine.json").read_text())
    assert [result["name"] for result in record["results"]] == [case.name for case in HELD_OUT]
    assert record["results"][0]["figures"]["ankle_depth_mm"] == -8
    mean = record["summary"]["error models"]["mean"]
    assert mean["change: hands"]["mean"] == pytest.approx(1.0)
    assert record["made_with"]["options"]["refine"]["passes"] == 3 and record["versions"]
    page = (tmp_path / "new/refine.html").read_text()
    assert "bruno: bursts 1000" in page and "held out" in page and "+100 %" in page


def test_the_avatars_table_has_a_row_for_each_variant(done, tmp_path, cli):
    avatar = ("study", "avatar", "--out", tmp_path, "--subjects", "bruno", "edgar")
    out = cli.works(*avatar, "--rows", "full", "with residual", "--fit.steps", 600)
    lines = out.splitlines()
    head = lines.index("held-out subjects") + 1
    assert lines[head].split() == ["psnr", "test"]
    assert lines[head + 1].split()[:4] == ["full", "30.00", "±", "0.00,"]
    assert lines[head + 2].startswith("with residual ") and "(+0.00)" in lines[head + 2]
    record = json.loads((tmp_path / "avatar.json").read_text())
    assert {r["variant"] for r in record["results"]} == {"full", "with residual"}
    assert record["made_with"]["options"]["fit"]["steps"] == 600
    page = (tmp_path / "avatar.html").read_text()
    assert "bruno: bursts 1000" in page and "held out" in page


def test_a_study_is_resumed_and_keeps_other_results(done, tmp_path, cli):
    lean = ("study", "refine", "--out", tmp_path, "--error-models", "lean")
    assert cli(*lean)[0] == 0
    first = list(done)
    assert first and {case.kind_of_errors for case, _ in first} == {"lean"}
    code, out, _ = cli("study", "refine", "--out", tmp_path)
    assert f"{len(first)} results are in" in out and len(done) == len(HELD_OUT)
    done.clear()
    assert cli(*lean)[0] == 0 and not done
    record = json.loads((tmp_path / "refine.json").read_text())
    names = [result["name"] for result in record["results"]]
    assert sorted(names) == sorted(case.name for case in HELD_OUT)
    assert cli(*lean, "--overwrite")[0] == 0 and done == first


def test_stage_1_alone_is_another_result_than_its_refinement(done, tmp_path, cli):
    limits = ("study", "refine", "--cases", "limits", "--out", tmp_path)
    out = cli.works(*limits, "--stage", 1)
    assert {variant for _, variant in done} == {"stage 1"} and "seed 140, room, held" not in out
    head = next(line for line in out.splitlines() if line.startswith("absolute, mm "))
    assert head.split()[2:6] == ["body,", "stage", "1", "body"]
    assert cli(*limits)[0] == 0
    assert {variant for _, variant in done} == {"stage 1", "refined"}
    kept = json.loads((tmp_path / "refine.json").read_text())["results"]
    assert len(kept) == len(done) == 2 * len(LIMITS)


def test_overwriting_removes_the_runs_of_an_avatar_study(done, tmp_path, cli):
    avatar = ("study", "avatar", "--out", tmp_path, "--cases", "tuning", "--error-models", "white")
    avatar += ("--subjects", "dalia")
    assert cli(*avatar)[0] == 0 and len(done) == len(VARIANTS)
    run = tmp_path / "runs/dalia-white-3/full"
    run.mkdir(parents=True)
    done.clear()
    assert cli(*avatar, "--rows", "full", "--overwrite")[0] == 0 and len(done) == 1
    assert not run.exists()  # or its avatar would be taken for the new one
    kept = json.loads((tmp_path / "avatar.json").read_text())["results"]
    assert [r["variant"] for r in kept] == [variant.name for variant in VARIANTS]


def test_names_that_no_case_has_are_refused(done, tmp_path, cli):
    refine = ("study", "refine", "--out", tmp_path)
    assert cli(*refine, "--subjects", "bruno", "13")[0] == 0
    assert {case.take.person for case, _ in done} == {"bruno", "13"}
    done.clear()
    other = ("study", "refine", "--out", tmp_path / "8", "--held-out-set", 8)
    assert cli(*other, "--error-models", "lean")[0] == 0
    assert done and all(case.take.seed // 100 == 8 for case, _ in done)
    for argument, name in (("--subjects", "amira"), ("--error-models", "lost")):
        err = cli.fails(*refine, argument, name)
        assert f"no '{name}'" in err and "these cases have:" in err
    err = cli.fails(*refine, "--subjects", "bruno", "--error-models", "focal")
    assert "no case has both" in err
    err = cli.fails("study", "avatar", "--out", tmp_path, "--rows", "best")
    assert "no 'best'; there are: as printed, " in err


def test_a_case_that_lacks_a_package_is_left_out_with_a_line(done, tmp_path, cli, monkeypatch):
    lacks = property(lambda case: "anny" if case.take.figure == "anny" else None)
    monkeypatch.setattr(StudyCase, "lacks", lacks)
    out = cli.works("study", "refine", "--out", tmp_path, "--error-models", "mixed")
    assert "because the package anny is not installed" in out
    assert all(case.take.figure != "anny" for case, _ in done) and len(done) == 1


def test_an_older_study_is_named_and_can_be_overwritten(done, tmp_path, cli):
    (tmp_path / "refine.json").write_text('{"cases": []}')
    refine = ("study", "refine", "--out", tmp_path, "--error-models", "lean")
    err = cli.fails(*refine)
    assert "another version of gva-mi wrote this study" in err and not done
    assert cli(*refine, "--overwrite")[0] == 0
