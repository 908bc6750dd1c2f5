"""The report's tables say what the run's files hold."""

from dataclasses import replace

import numpy as np

from gva_mi.fit.evaluation import report
from gva_mi.fit.evaluation.regions import CLOSE_UPS, close_ups
from gva_mi.fit.evaluation.report_pictures import _joints, enlarged
from gva_mi.fit.evaluation.surface_figures import SurfaceFigures
from gva_mi.fit.run_folder import LAPS
from gva_mi.pose.evaluation.figures import PoseFigures


def test_the_time_of_a_fit_is_told_part_by_part():
    steps = np.array([1.0, 2.0, 9.0])
    history = {name: (k + 1) * steps for k, name in enumerate(LAPS)}
    history["milliseconds"] = sum(history.values())
    (table,) = report._time(history)
    *parts, whole = table.rows
    assert len(parts) == len(LAPS) and table.head[1:] == (
        "all steps, s", "a step: median, ms", "mean, ms", "longest, ms", "share",
    )  # fmt: skip
    assert parts[0][1:] == ["0.0", "2.0", "4.0", "9.0", "17%"]
    assert parts[1][1:] == ["0.0", "4.0", "8.0", "18.0", "33%"]
    assert whole[0] == "all" and whole[1:] == ["0.1", "12.0", "24.0", "54.0", "100%"]


def test_a_history_of_an_older_program_has_no_table_of_time():
    assert report._time({"loss": np.ones(3), "milliseconds": np.ones(3)}) == []


def test_trained_poses_stand_beside_refined_ones():
    figures = PoseFigures.from_json({})
    table = report._refinement_table(figures, {"body": 12.34, "feet_aligned": 5.0})
    column = table.head.index("trained")
    found = {row[0]: row[column] for row in table.rows}
    assert found["vertices, mm"] == "12.3" and found["feet, pelvis on pelvis, mm"] == "5.0"
    assert found["hands, mm"] == "–" and table.head.index("refined") == column - 1


def test_a_moment_of_the_surface_is_a_line():
    moment = SurfaceFigures(500, "after", 16_032, {"all": 0.3}, {"hem": 28.0}, 5.0, 3.5, 42.0)
    older = replace(moment, elongation=None, largest_mm=None)
    table = report.surface_table([moment, older])
    named = dict(zip(table.head, table.rows[0], strict=True))
    assert named["bias of hem, mm"] == "28.0" and named["stray, mm"] == "5.0"
    assert named["elongation"] == "3.5" and named["largest, mm"] == "42"
    assert table.rows[1][-2:] == ("–", "–")


def test_close_ups_hold_what_they_are_named_after(known, video):
    """The truth above, the render below, of the boxes that the picture holds."""
    frame = video[0]
    joints = _joints(known, frame)
    boxes = dict(close_ups(frame.camera, joints))
    assert {"head and hair", "left armpit", "right armpit"} <= set(boxes) <= set(CLOSE_UPS)
    for name, image in enlarged(known, frame):
        box = boxes[name]
        height, width = image.shape[:2]
        assert height == 2 * width and width % box.width == 0
        above = image[: height // 2 : width // box.width, :: width // box.width]
        cut = frame.on_background()[box.top : box.bottom, box.left : box.right]
        assert np.abs(above / 255 - cut).mean() < 0.02
    head, hem = boxes["head and hair"], boxes["hem"]
    assert head.bottom < hem.top + hem.height / 2 and hem.width > head.width


def test_without_novel_poses_there_is_nothing_to_enlarge(known, video):
    assert video.truth is None and report._close_ups(known, video) == []
