"""A study's tables count subjects and error models once."""

from dataclasses import replace

from gva_mi.evaluate.figures import Figure
from gva_mi.study import report
from gva_mi.study.cases import HELD_OUT, TUNING, StudyCase, Take
from gva_mi.study.engine import Outcome

PSNR = "PSNR, dB"

BRUNO = [case for case in HELD_OUT if case.take.person == "bruno"]
EDGAR = [case for case in HELD_OUT if case.take.person == "edgar"]


def outcome(case, variant, psnr):
    about = {"subject": case.name, "variant": variant, "split": "test"}
    values = {"white": psnr, "hands": psnr - 5}
    figures = [Figure(**about, region=r, metric=PSNR, value=x) for r, x in values.items()]
    return Outcome(case, variant, (*figures, Figure(**about, metric="LPIPS", value=None)))


def test_variants_are_compared_in_the_same_cases_and_tuned_subjects_are_apart():
    """Of Bruno one case has both variants: 29 - 30, and not 29 minus the mean of his two."""
    outcomes = [
        outcome(BRUNO[0], "full", 30.0), outcome(BRUNO[1], "full", 32.0),
        outcome(EDGAR[0], "full", 28.0), outcome(TUNING[0], "full", 99.0),
        outcome(BRUNO[0], "with residual", 29.0), outcome(EDGAR[0], "with residual", 26.0),
    ]  # fmt: skip
    found = report.study_tables("avatar", outcomes)
    assert list(found) == ["held out subjects", "tuning subjects"]
    whole, boxes = found["held out subjects"]
    assert whole.rows == [
        ["full", "29.50 ± 1.50, worst 28.00"],
        ["with residual", "27.50 ± 1.50, worst 26.00 (-1.50)"],
    ]
    assert boxes.rows[0] == ["full", "24.50 ± 1.50, worst 23.00"]
    assert found["tuning subjects"][0].rows == [["full", "99.00 ± 0.00"]]


def test_lights_have_a_row_and_each_region_a_table():
    def lit(case, light, **psnr):
        figures = [
            Figure(variant=light, region=region, alignment=way, metric=PSNR,
                   value=x - (region == "silhouette"))
            for region in ("white", "silhouette") for way, x in psnr.items()
        ]  # fmt: skip
        return Outcome(case, light, tuple(figures))

    outcomes = [
        lit(BRUNO[0], "left", kept=20.0, relit=25.0), lit(EDGAR[0], "left", kept=21.0, relit=27.0),
        lit(BRUNO[0], "sky", kept=30.0, relit=29.0),
    ]  # fmt: skip
    ((title, (whole, silhouette)),) = report.study_tables("relight", outcomes).items()
    assert title == "lights, held out subjects" and title in report.TEXTS
    assert list(whole.head) == ["PSNR, dB, white", "kept", "relit"]
    assert whole.rows == [["left", "20.50", "26.00"], ["sky", "30.00", "29.00"]]
    assert silhouette.rows[1] == ["sky", "29.00", "28.00"]


def test_a_difference_within_the_spread_of_one_ulp_is_no_more_than_chance():
    """Standard errors of 0.1 and 0.1 dB: a difference of 0.2 is chance, and one of 1 is not."""

    def repeated(variant, psnr):
        figure = outcome(EDGAR[0], variant, psnr).figures[0]
        return Outcome(EDGAR[0], variant, (replace(figure, spread=0.2, runs=4),))

    found = report.study_tables("avatar", [
        repeated("full", 28.0), repeated("with residual", 28.2), repeated("GART-like", 27.0),
    ])  # fmt: skip
    rows = {row[0]: row[1] for row in found["held out subjects"][0].rows}
    assert rows["with residual"].endswith("(≈ +0.20 ± 0.14)")
    assert rows["GART-like"].endswith("(-1.00 ± 0.14)")


def refined(error_model, draw, change, ankles, iou):
    case = StudyCase(Take(seed=draw), error_model, draw)
    return Outcome(case, "refined", (
        Figure(region="body", metric="change", value=change),
        Figure(region="ankles", metric="refined depth, mm", value=ankles),
        Figure(metric="IoU - limit", value=iou),
    ))  # fmt: skip


def test_an_error_model_counts_once_and_the_worst_depth_is_the_farthest_off():
    white = [refined("white", k, x, 10.0, -0.1) for k, x in enumerate((-0.9, -0.8, -0.7))]
    found = report.study_tables("refine", [*white, refined("lean", 9, -0.4, -30.0, 0.05)])
    rows = {table.head[0]: {row[0]: row[1] for row in table.rows}
            for table in found["error models"]}  # fmt: skip
    assert rows == {
        "change": {"white": "-80 %", "lean": "-40 %", "mean": "-60 %", "worst": "-40 %"},
        "refined depth, mm": {"white": "+10.0", "lean": "-30.0", "mean": "-10.0", "worst": "-30.0"},
        "IoU - limit": {"white": "-0.100", "lean": "+0.050", "mean": "-0.025", "worst": "-0.100"},
    }


def test_methods_are_compared_with_stage_1_over_the_cases_that_all_have():
    def measured(case, variant, error, increased):
        return Outcome(case, variant, (
            Figure(region="body", metric="stage 1 error, mm", value=50.0),
            Figure(region="body", metric="refined error, mm", value=error),
            Figure(region="body", metric="increased", value=increased),
        ))  # fmt: skip

    first, second = (StudyCase(Take(seed=k), "white", k) for k in (1, 2))
    found = report.study_tables("refine", [
        measured(first, "refined", 30.0, 0.0), measured(first, "Eq. 8 as printed", 60.0, 0.5),
        measured(second, "refined", 99.0, 1.0),
    ])  # fmt: skip
    assert list(found) == [
        "methods", "error models, refined", "error models, Eq. 8 as printed",
    ]  # fmt: skip
    errors, worse = ({row[0]: row[1] for row in table.rows} for table in found["methods"])
    assert errors == {"stage 1": "50.0", "refined": "30.0", "Eq. 8 as printed": "60.0"}
    assert worse == {"refined": "0 %", "Eq. 8 as printed": "50 %"}
