"""``gva-mi study``: cases are chosen by name, results are kept, tables say what was found."""

import json
from dataclasses import dataclass

import pytest

from gva_mi.evaluate.figures import Figure
from gva_mi.study.avatar_study import AvatarStudy
from gva_mi.study.cases import HELD_OUT, LIMITS, StudyCase
from gva_mi.study.refine_study import RefineStudy
from gva_mi.study.variants import VARIANTS

REFINED = [Figure(region="body", alignment="absolute", metric="change", value=-0.75),
    Figure(region="hands", alignment="absolute", metric="change", value=1.0),
    Figure(region="body", alignment="absolute", metric="stage 1 error, mm", value=80.0),
    Figure(region="ankles", metric="refined depth, mm", value=-8.0)]  # fmt: skip
FITTED = [Figure(split="test", region="white", metric="PSNR, dB", value=30.0),
    Figure(metric="seconds", value=60.0)]  # fmt: skip


@dataclass
class Work:
    """As if a case were computed at once."""

    figures: list
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
    for study, figures in ((RefineStudy, REFINED), (AvatarStudy, FITTED)):
        rounds = lambda self, missing, f=figures: [[Work(f, log, pair) for pair in missing]]
        monkeypatch.setattr(study, "rounds", rounds)
    monkeypatch.setattr(StudyCase, "lacks", None)
    return log


def test_the_refinements_table_has_a_row_for_each_error_model(done, tmp_path, cli):
    out = cli.works("study", "refine", "--out", tmp_path / "new", "--frames", 8)
    families = list(dict.fromkeys(case.kind_of_errors for case in HELD_OUT))
    lines = out.splitlines()
    start = next(k for k, line in enumerate(lines) if line.startswith("change "))
    rows = lines[start + 1 : start + 3 + len(families)]
    assert lines[start].split() == ["change", "absolute,", "body", "absolute,", "hands"]
    assert [row.split("  ")[0] for row in rows] == [*families, "mean", "worst"]
    assert rows[0].split()[1:5] == ["-75", "%", "+100", "%"]
    record = json.loads((tmp_path / "new/refine.json").read_text())
    assert list(record["cases"]) == [case.name for case in HELD_OUT]
    depths = [row for row in record["figures"] if row["metric"] == "refined depth, mm"]
    assert len(depths) == len(HELD_OUT) and depths[0]["value"] == -8
    assert depths[0]["subject"] == HELD_OUT[0].name and depths[0]["variant"] == "refined"
    assert record["made_with"]["options"]["frames"] == 8 and record["versions"]
    page = (tmp_path / "new/refine.html").read_text()
    assert "bruno: bursts 1000" in page and "held out" in page and "+100 %" in page


def test_the_avatars_table_has_a_row_for_each_variant(done, tmp_path, cli):
    avatar = ("study", "avatar", "--out", tmp_path, "--subjects", "bruno", "edgar")
    out = cli.works(*avatar, "--rows", "full", "with residual", "--steps", 600)
    lines = out.splitlines()
    head = lines.index("held out subjects") + 1
    assert lines[head].split() == ["PSNR,", "dB", "test,", "white,", "PSNR,", "dB"]
    assert lines[head + 1].split()[:4] == ["full", "30.00", "±", "0.00,"]
    assert lines[head + 2].startswith("with residual ") and "(+0.00)" in lines[head + 2]
    record = json.loads((tmp_path / "avatar.json").read_text())
    assert {row["variant"] for row in record["figures"]} == {"full", "with residual"}
    assert record["made_with"]["options"]["steps"] == 600
    page = (tmp_path / "avatar.html").read_text()
    assert "bruno: bursts 1000" in page and "held out" in page


def results(path):
    """Cases and variants whose figures a file holds."""
    rows = json.loads(path.read_text())["figures"]
    return list(dict.fromkeys((row["subject"], row["variant"]) for row in rows))


def test_a_study_is_resumed_and_keeps_other_results(done, tmp_path, cli):
    lean = ("study", "refine", "--out", tmp_path, "--error-models", "lean")
    assert cli(*lean)[0] == 0
    first = list(done)
    assert first and {case.kind_of_errors for case, _ in first} == {"lean"}
    code, out, _ = cli("study", "refine", "--out", tmp_path)
    assert f"{len(first)} results are in" in out and len(done) == len(HELD_OUT)
    done.clear()
    assert cli(*lean)[0] == 0 and not done
    names = [name for name, _ in results(tmp_path / "refine.json")]
    assert sorted(names) == sorted(case.name for case in HELD_OUT)
    assert cli(*lean, "--overwrite")[0] == 0 and done == first


def test_stage_1_alone_is_another_result_than_its_refinement(done, tmp_path, cli):
    limits = ("study", "refine", "--cases", "limits", "--out", tmp_path)
    out = cli.works(*limits, "--stage", 1)
    assert {variant for _, variant in done} == {"stage 1"} and "seed 140, scene room" in out
    assert "stage 1 error, mm" in out
    assert cli(*limits)[0] == 0
    assert {variant for _, variant in done} == {"stage 1", "refined"}
    assert len(results(tmp_path / "refine.json")) == len(done) == 2 * len(LIMITS)


def test_overwriting_removes_the_runs_of_an_avatar_study(done, tmp_path, cli):
    avatar = ("study", "avatar", "--out", tmp_path, "--cases", "tuning", "--error-models", "white")
    avatar += ("--subjects", "dalia")
    assert cli(*avatar)[0] == 0 and len(done) == len(VARIANTS)
    run = tmp_path / "runs/dalia-white-3/full"
    run.mkdir(parents=True)
    done.clear()
    assert cli(*avatar, "--rows", "full", "--overwrite")[0] == 0 and len(done) == 1
    assert not run.exists()  # or its avatar would be taken for the new one
    kept = [variant for _, variant in results(tmp_path / "avatar.json")]
    assert kept == [variant.name for variant in VARIANTS]


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


def test_a_case_that_lacks_a_package_is_left_out_with_a_line(done, tmp_path, cli, monkeypatch):
    lacks = property(lambda case: "anny" if case.take.figure == "anny" else None)
    monkeypatch.setattr(StudyCase, "lacks", lacks)
    out = cli.works("study", "refine", "--out", tmp_path, "--error-models", "mixed")
    assert "because the package anny is not installed" in out
    assert all(case.take.figure != "anny" for case, _ in done) and len(done) == 1
