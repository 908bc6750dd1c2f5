"""The long table: rows come back from files, subjects count once, cells have forms."""

import csv
import io
import json

import numpy as np
import pytest

from gva_mi.evaluate.figures import Figure, figures_from, pivot, table, to_json, where

PSNR = "PSNR, dB"
FIGURES = [
    Figure(subject="ann", variant="full", split="test", metric=PSNR, value=30.0),
    Figure(subject="ann", variant="full", split="test", metric=PSNR, value=32.0),
    Figure(subject="bob", variant="full", split="test", metric=PSNR, value=28.0),
    Figure(subject="bob", variant="less", split="novel_pose", metric="LPIPS", value=None),
    Figure(subject="bob", variant="less", split="novel_pose", metric="change", value=-0.5),
]


def test_rows_come_back_from_json_and_are_rows_of_csv():
    rows = json.loads(json.dumps(to_json(FIGURES)))
    assert figures_from(rows) == tuple(FIGURES)
    text = io.StringIO()
    csv.DictWriter(text, rows[0]).writerows(rows)
    assert text.getvalue().splitlines()[0] == 'ann,full,test,,,"PSNR, dB",30.0,,1'


@pytest.mark.parametrize("row", [[], {"metric": PSNR}, {"metric": "best", "value": 1.0},
                                 {"metric": PSNR, "value": "high"}])  # fmt: skip
def test_what_is_no_row_is_refused(row):
    with pytest.raises(ValueError):
        figures_from([row])


def test_a_subject_counts_once_however_many_figures_it_has():
    cells = pivot(FIGURES, ("variant",), ("split",))
    assert cells["full",]["test", PSNR].tolist() == [31.0, 28.0]
    assert cells["less",] == {("novel_pose", "change"): np.array([-0.5])}
    assert where(FIGURES, subject="bob", variant=("less", "more")) == FIGURES[3:]


def test_a_table_writes_each_metric_in_its_form():
    found = table(pivot(FIGURES, ("variant",), ("split",)), "way")
    assert found.head == ("way", "test, PSNR, dB", "novel pose, change")
    assert found.rows == [["full", "29.50", "–"], ["less", "–", "-50 %"]]
