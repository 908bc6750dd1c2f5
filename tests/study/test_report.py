"""The report's tables say what the run's files hold, and its pictures what they are named after."""

import base64
import io
from dataclasses import replace

from PIL import Image

from gva_mi.study import report
from gva_mi.study.evaluate import SplitScores
from gva_mi.study.measure import PoseFigures
from gva_mi.study.metrics import ALIGNED, Metrics, Training
from gva_mi.study.pictures import ShownAvatar, picture_sections


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


def test_details_are_rendered_as_large_as_they_are_shown(known, video, body):
    test, *_, rest = picture_sections([("", {"render": ShownAvatar.of(known, video, body)})], 1)
    hand = next(p for p in test.pictures if p.caption == "frame 3, hands")
    image = Image.open(io.BytesIO(base64.b64decode(hand.data.partition(",")[2])))
    assert image.width == 3 * image.height >= 600
    assert "the picture, render, difference" in test.text and rest.title == "The Gaussians"
