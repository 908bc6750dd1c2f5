"""Pages hold what they are given."""

import base64
import io

import numpy as np
import pytest
import torch
from PIL import Image

from gva_mi.body.pose import JOINTS, LEFT_HAND
from gva_mi.evaluate import report
from gva_mi.evaluate.figures import Figure, Table
from gva_mi.evaluate.measure import ALIGNED, Metrics
from gva_mi.evaluate.page import Headline, Section, animation, picture, write_page
from gva_mi.evaluate.pictures import picture_sections, seen_map, shown_views, trust_map
from gva_mi.subject.problems import doubt, error

PSNR = "PSNR, dB"


def test_a_page_is_one_file_with_its_pictures(tmp_path):
    image = np.zeros((4, 6, 3), np.uint8)
    section = Section("Section <1>",
        [picture("grey", image + 128), animation("moving", [image] * 2)],
        tables=[Table(("name", "value"), [("x < y", "1.2"), ("z", "–")])], text="A & B",
        headlines=[Headline("3 mm", "error")],
        scale=[((1, 2, 3), "dark"), ((250, 250, 250), "light")])  # fmt: skip
    write_page(tmp_path / "page.html", title="Title", subtitle="Subtitle", sections=[section],
        settings={"seed": 7}, verdict=Headline("Good", "from all sides"))  # fmt: skip
    page = (tmp_path / "page.html").read_text()
    for text in (
        "Section &lt;1&gt;",
        "A &amp; B",
        "x &lt; y",
        "1.2",
        "–",
        "3 mm",
        "Good",
        "rgb(1, 2, 3)",
    ):
        assert text in page, text
    assert "&#34;seed&#34;: 7" in page and page.count("data:image/webp;base64,") == 2
    assert "http" not in page and [p.name for p in tmp_path.iterdir()] == ["page.html"]


def test_the_first_figures_are_errors_of_poses_then_psnr_size_and_time():
    pose = {"region": "body", "alignment": "pelvis-aligned"}
    figures = [
        Figure(**pose, metric="stage 1 error, mm", value=48.6),
        Figure(**pose, metric="refined error, mm", value=15.2),
        Figure(split="test", region="white", metric=PSNR, value=35.24),
        Figure(split="test", region="person", metric=PSNR, value=20.0),
        Figure(split="test", region="hands", metric=PSNR, value=1.0),
        Figure(split="novel_pose", region="person", alignment=ALIGNED, metric=PSNR, value=27.0),
        *(Figure(metric=name, value=1234) for name in ("Gaussians", "steps", "seconds")),
    ]
    metrics = Metrics(figures=tuple(figures), size=(4, 4), protocol={}, options={}, versions={})
    found = [(headline.value, headline.label) for headline in report.headlines(metrics)]
    assert found[0][0] == "49 → 15 mm"
    assert found[1:4] == [  # the word is for the person's box of the video's own frames
        ("35.2 dB", "PSNR, test, whole picture"),
        ("20.0 dB", "PSNR, test, person's box: fair (good: 24 dB)"),
        ("27.0 dB", "PSNR, novel pose, aligned, person's box"),
    ]
    assert found[4:] == [("1,234", name) for name in ("Gaussians", "steps", "seconds")]


def test_details_are_rendered_as_large_as_they_are_shown(known, video, body):
    test, *_, rest = picture_sections(known, shown_views(known, video, body), 1)
    assert not any("," in whole.caption for whole in test.pictures)  # else rows differ in height
    hand = next(p for p in test.close_ups if p.caption == "frame 3, hands")
    image = Image.open(io.BytesIO(base64.b64decode(hand.data.partition(",")[2])))
    assert image.width == 3 * image.height >= 600
    assert test.title == "Test frames" and rest.title == "The Gaussians"


ALL = ["front", "left side", "back", "right side"]


@pytest.mark.parametrize(
    ("problems", "degrees", "unseen", "psnr", "words", "reason"),
    [
        ([], 360, [], 26.0, "Good", "360 of 360"),
        ([], 360, [], 20.0, "Usable from all sides", "360"),
        (["arms at the body"], 360, [], 26.0, "Usable from all sides", "arms at the body"),
        (["not seen from all sides"], 110, ALL[1:3], 26.0, "Usable from the front and right side",
         "110 of 360 degrees: left side and back are guesses."),
        ([], 360, [], 12.0, "Film again, because", "360"),
    ],
)  # fmt: skip
def test_the_verdict_is_one_of_three(problems, degrees, unseen, psnr, words, reason):
    problems = [doubt(what, "1 of 2", "cause", "remedy") for what in problems]
    seen = [side for side in ALL if side not in unseen]
    found = report.verdict(problems, degrees, seen, unseen, psnr)
    assert found.value.startswith(words) and reason in found.label


def test_an_error_of_the_folder_asks_for_another_video():
    problem = error("inverted masks", "3 of 3", "cause", "remedy")
    found = report.verdict([problem], 360, ALL, [], None)
    assert found.value == "Film again, because of this: inverted masks (3 of 3)"


def test_the_avatar_is_coloured_by_how_well_each_part_was_seen(known, studio):
    """A front that alone was filmed is well seen, and most of the back is a guess."""
    section = seen_map(known, studio, studio.pose[0])
    views = [picture.caption for picture in section.pictures]
    assert views == ["front", "left side", "back", "right side"]
    guess, seen = (np.array(section.scale[i][0]) for i in (0, -1))
    share = {}
    for one in section.pictures:
        image = Image.open(io.BytesIO(base64.b64decode(one.data.partition(",")[2])))
        pixels = np.asarray(image.convert("RGB")).reshape(-1, 3).astype(float)
        person = pixels[pixels.min(1) < 200]
        share[one.caption] = np.mean(
            np.linalg.norm(person - seen, axis=1) < np.linalg.norm(person - guess, axis=1)
        )
    assert share["front"] > 0.8 and share["back"] < 0.5, share


def test_the_avatar_is_coloured_by_how_uncertain_each_part_is(known, studio):
    """Certain but for the left forearm and hand: these alone have the colour of a guess."""
    mm = torch.full((55,), 5.0)
    mm[[JOINTS.index("left_wrist"), *range(LEFT_HAND.start, LEFT_HAND.stop)]] = 90.0
    section = trust_map(known, mm, studio.pose[0])
    assert "the left hand least (90 mm)" in section.text
    sure, unsure = (np.array(section.scale[i][0]) for i in (0, -1))
    image = Image.open(io.BytesIO(base64.b64decode(section.pictures[0].data.partition(",")[2])))
    pixels = np.asarray(image.convert("RGB")).astype(float)
    person = pixels.min(2) < 200
    near = lambda color: np.linalg.norm(pixels - color, axis=2) < 60
    guessed, certain = near(unsure) & person, near(sure) & person
    assert 0.01 < guessed.sum() / person.sum() < 0.25 and certain.sum() > 0.5 * person.sum()
    assert np.nonzero(guessed)[1].min() > np.median(np.nonzero(person)[1])  # her left: our right
