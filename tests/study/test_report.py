"""Pages hold what they are given; a study's tables count subjects and error models once."""

import base64
import io

import numpy as np
from PIL import Image

from gva_mi.study import report
from gva_mi.study.cases import HELD_OUT, TUNING, StudyCase, Take
from gva_mi.study.engine import Outcome
from gva_mi.study.evaluate import ALIGNED, Metrics
from gva_mi.study.figures import Figure, Table
from gva_mi.study.page import Headline, Section, animation, picture, write_page
from gva_mi.study.pictures import picture_sections, shown_views

PSNR = "PSNR, dB"


def test_a_page_is_one_file_with_its_pictures(tmp_path):
    image = np.zeros((4, 6, 3), np.uint8)
    section = Section(
        "Section <1>",
        [picture("grey", image + 128), animation("moving", [image] * 2)],
        tables=[Table(("name", "value"), [("x < y", "1.2"), ("z", "–")])],
        text="A & B",
    )
    write_page(
        tmp_path / "page.html",
        title="Title",
        subtitle="Subtitle",
        headlines=[Headline("3 mm", "error")],
        sections=[section],
        settings={"seed": 7},
    )
    page = (tmp_path / "page.html").read_text()
    for text in ("Section &lt;1&gt;", "A &amp; B", "x &lt; y", "1.2", "–", "3 mm"):
        assert text in page, text
    assert "&#34;seed&#34;: 7" in page and page.count("data:image/webp;base64,") == 2
    assert "http" not in page and [p.name for p in tmp_path.iterdir()] == ["page.html"]


def test_the_first_figures_are_errors_of_poses_then_psnr_size_and_time():
    pose = {"region": "body", "alignment": "pelvis-aligned"}
    figures = [
        Figure(**pose, metric="stage 1 error, mm", value=48.6),
        Figure(**pose, metric="refined error, mm", value=15.2),
        Figure(split="test", region="white", metric=PSNR, value=35.24),
        Figure(split="test", region="hands", metric=PSNR, value=1.0),
        Figure(split="novel_pose", region="person", alignment=ALIGNED, metric=PSNR, value=27.0),
        *(Figure(metric=name, value=1234) for name in ("Gaussians", "steps", "seconds")),
    ]
    metrics = Metrics(figures=tuple(figures), size=(4, 4), protocol={}, options={}, versions={})
    found = [(headline.value, headline.label) for headline in report.headlines(metrics)]
    assert found[0][0] == "49 → 15 mm"
    assert found[1:3] == [
        ("35.2 dB", "PSNR, test, whole picture"),
        ("27.0 dB", "PSNR, novel pose, aligned, person's box"),
    ]
    assert found[3:] == [("1,234", name) for name in ("Gaussians", "steps", "seconds")]


def test_details_are_rendered_as_large_as_they_are_shown(known, video, body):
    test, *_, rest = picture_sections(known, shown_views(known, video, body), 1)
    hand = next(p for p in test.pictures if p.caption == "frame 3, hands")
    image = Image.open(io.BytesIO(base64.b64decode(hand.data.partition(",")[2])))
    assert image.width == 3 * image.height >= 600
    assert test.title == "Test frames" and rest.title == "The Gaussians"


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
