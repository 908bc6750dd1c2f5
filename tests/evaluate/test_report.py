"""Pages hold what they are given."""

import base64
import io

import numpy as np
from PIL import Image

from gva_mi.evaluate import report
from gva_mi.evaluate.figures import Figure, Table
from gva_mi.evaluate.measure import ALIGNED, Metrics
from gva_mi.evaluate.page import Headline, Section, animation, picture, write_page
from gva_mi.evaluate.pictures import picture_sections, shown_views

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
