"""The report's tables say what the run's files hold, and its pictures what they are named after."""

import base64
import io
from dataclasses import replace

import numpy as np
from PIL import Image

from gva_mi.study import report
from gva_mi.study.evaluate import SplitScores
from gva_mi.study.measure import PoseFigures
from gva_mi.study.metrics import ALIGNED, Metrics, Training
from gva_mi.study.pictures import ShownAvatar, difference, picture_sections
from gva_mi.study.surface import SurfaceFigures


def test_the_first_figures_are_pose_errors_without_depth_then_psnr_of_picture_and_person():
    errors = {"aligned_vertex_mm": (48.6, 15.2), "pelvis_depth_mm": (-11.6, 55.4)}
    pairs = {f"{key}_stage1": before for key, (before, _) in errors.items()}
    pairs |= {key: after for key, (_, after) in errors.items()}
    scores = [("white", 35.24), ("black", 36.0), ("person", 30.31)]
    rows = [SplitScores("full", "test", x, 1.0, None, 0.0, region=where) for where, x in scores]
    rows = (*rows, replace(rows[0], name=ALIGNED, split="novel_pose", psnr=26.9))
    training = Training(steps=10, seconds=61.0, gaussians=1234, size=(4, 4))
    figures = {"rows": rows, "refinement": PoseFigures(pairs), "training": training}
    metrics = Metrics(**figures, options={}, versions={})
    values = [headline.value for headline in report._headlines(metrics)]
    assert values[:2] == ["49 → 15 mm", "-12 → +55 mm"]
    assert values[2:] == ["35.2 / 30.3 dB", "26.9 / – dB", "1,234", "1 min 01 s"]


def test_a_moment_of_the_surface_is_a_row():
    figures = {"spacing of all": 0.3, "bias of hem, mm": 28.0, "elongation": 3.5}
    moment = SurfaceFigures(500, "after", 16_032, figures)
    table = report.surface_table([moment, replace(moment, figures={"spacing of all": 0.4})])
    assert table.head[3:] == tuple(figures)
    assert [row[3:] for row in table.rows] == [("0.30", "28.0", "3.50"), ("0.40", "–", "–")]


def test_details_are_rendered_as_large_as_they_are_shown(known, video, body):
    test, *_, rest = picture_sections([("", {"render": ShownAvatar.of(known, video, body)})], 1)
    hand = next(p for p in test.pictures if p.caption == "frame 3, hands")
    image = Image.open(io.BytesIO(base64.b64decode(hand.data.partition(",")[2])))
    assert image.width == 3 * image.height >= 600
    assert "the picture, render, difference" in test.text and rest.title == "The Gaussians"


def test_differences_are_red():
    target, image = np.zeros((1, 2, 3), np.uint8), np.array([[[0, 0, 0], [9, 64, 0]]], np.uint8)
    assert difference(target, image).tolist() == [[[255, 255, 255], [190, 20, 40]]]
