"""``gva-mi study refine``: the table says what the rows hold, and is kept."""

import json

import pytest
import torch

from gva_mi.commands import study as studies
from gva_mi.pose.evaluation.measure import Measured, VertexErrors
from gva_mi.pose.evaluation.study import HELD_OUT, TUNING, CaseResult


def row(case, noise, before, after):
    errors = lambda mm: VertexErrors(*(torch.full((4,), mm * k) for k in (1.0, 2, 3, 4, 5, 6)))
    iou = lambda value: torch.full((4,), value)
    ious = iou(0.7), iou(0.8), iou(0.75), iou(0.82)
    return CaseResult(case, noise, Measured(errors(before), errors(after), *ious, 1.0))


@pytest.fixture
def done(monkeypatch):
    """As if two people had been refined, one of whom got worse."""
    seen = []

    def refine(folder, cases, body, options, progress):
        seen.append((folder, cases, options))
        yield row(cases[0], 1.0, 80.0, 20.0)
        yield row(cases[1], 2.0, 40.0, 50.0)

    monkeypatch.setattr(studies, "refine_cases", refine)
    return seen


def test_the_table_says_what_was_measured(done, tmp_path, cli):
    code, out, err = cli("study", "refine", "--out", tmp_path / "new", "--refine.passes", 3)
    assert code == 0, err
    head, first, second, mean = (line.split() for line in out.splitlines()[-5:-1])
    assert head[:4] == ["mm", "body", "hands", "feet"]
    name = f"{HELD_OUT[0].name}, noise 1".split()
    assert first[: len(name)] == name
    assert first[len(name) : len(name) + 6] == ["80", "→", "20", "160", "→", "40"]
    assert first[-7:] == ["+0.050", "0.820", "0", "%", "0", "%", "1.00"]
    assert second[-7:] == ["+0.050", "0.820", "100", "%", "100", "%", "1.00"]
    assert mean[2:4] == ["-25", "%"]  # of -75 % and +25 %
    record = json.loads((tmp_path / "new/refine.json").read_text())
    assert record["rows"][1]["change"]["feet"] == pytest.approx(0.25)
    assert record["options"]["refine"]["passes"] == 3 and record["versions"]


def test_people_it_was_tuned_on_are_apart(done, tmp_path, cli):
    for name, cases in (("tuning", TUNING), ("held-out", HELD_OUT), ("all", TUNING + HELD_OUT)):
        assert cli("study", "refine", "--out", tmp_path, "--cases", name)[0] == 0
        assert done[-1][1] == cases
    assert not {c.name for c in TUNING} & {c.name for c in HELD_OUT}
