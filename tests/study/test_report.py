"""The report's tables say what the run's files hold, and its pictures what they are named after."""

from dataclasses import replace

import numpy as np
import pytest
import roma
import torch

from gva_mi.fit.run_folder import LAPS
from gva_mi.study import report
from gva_mi.study.regions import CLOSE_UPS, close_ups
from gva_mi.study.report_pictures import _joints, compared, turntable, zoomed
from gva_mi.study.surface import SurfaceFigures


def test_the_time_of_a_fit_is_listed_part_by_part():
    steps = np.array([1.0, 2.0, 9.0])
    history = {name: (k + 1) * steps for k, name in enumerate(LAPS)}
    history["milliseconds"] = sum(history.values())
    (table,) = report._time(history)
    *parts, whole = table.rows
    assert len(parts) == len(LAPS)
    assert parts[0][1:] == ["0.0", "2.0", "4.0", "9.0", "17%"]
    assert parts[1][1:] == ["0.0", "4.0", "8.0", "18.0", "33%"]
    assert whole[0] == "all" and whole[1:] == ["0.1", "12.0", "24.0", "54.0", "100%"]
    assert report._time({"loss": np.ones(3), "milliseconds": np.ones(3)}) == []  # an older run


def test_a_moment_of_the_surface_is_a_row():
    moment = SurfaceFigures(500, "after", 16_032, {"all": 0.3}, {"hem": 28.0}, 5.0, 3.5, 42.0)
    older = replace(moment, elongation=None, largest_mm=None)
    table = report.surface_table([moment, older])
    named = dict(zip(table.head, table.rows[0], strict=True))
    assert named["bias of hem, mm"] == "28.0" and named["stray, mm"] == "5.0"
    assert named["elongation"] == "3.5" and named["largest, mm"] == "42"
    assert table.rows[1][-2:] == ("–", "–")


def test_close_ups_show_the_picture_above_the_render(known, video):
    frame = video[0]
    boxes = dict(close_ups(frame.camera, _joints(known, frame)))
    found = dict(zoomed(known, frame, "close-ups"))
    assert {"head and hair", "left armpit"} <= set(found) == set(boxes) <= set(CLOSE_UPS)
    for name, image in found.items():
        box, (height, width) = boxes[name], image.shape[:2]
        assert height == 2 * width and width % box.width == 0
        above = image[: height // 2 : width // box.width, :: width // box.width]
        cut = frame.on_background()[box.top : box.bottom, box.left : box.right]
        assert np.abs(above / 255 - cut).mean() < 0.02


def test_a_face_is_shown_if_it_faces_the_camera(known, video):
    """The subject turns: it faces the camera in its first frame, and not in its fourth."""
    ((_, image),) = zoomed(known, video[0], "face")
    assert image.shape[0] == 2 * image.shape[1] >= 200 and (image < 200).any()
    assert not list(zoomed(known, video[3], "face"))


def test_differences_are_red(known, video):
    frame = video[0]
    dark = replace(frame, image=np.zeros_like(frame.image))
    same, other = (compared(known, f)[:, -20:].astype(int) for f in (frame, dark))
    assert (other[..., 0] - other[..., 1]).max() > 150 > (same[..., 0] - same[..., 1]).max()


WORLDS = {"z up": (np.pi / 2, 0, 0), "askew": (0.4, -1.1, 0.7)}


@pytest.mark.parametrize("world", WORLDS)
def test_the_turntable_does_not_depend_on_the_world_axes(world, known, video):
    frame, R = video[0], roma.rotvec_to_rotmat(torch.tensor(WORLDS[world], dtype=torch.float32))
    root, rotations = known.rig.joints[0], frame.pose.rotations.clone()
    rotations[0, 0] = roma.rotmat_to_rotvec(R @ roma.rotvec_to_rotmat(rotations[0, 0]))
    transl = (R @ (root + frame.pose.transl[0]) - root)[None]
    T = frame.camera.T_camera_world.copy()
    T[:3, :3] = T[:3, :3] @ R.double().numpy().T
    pose = replace(frame.pose, rotations=rotations, transl=transl)
    moved = replace(frame, pose=pose, camera=frame.camera.with_matrices(T, frame.camera.K))
    ours = list(turntable(known, frame, 4))
    for a, b in zip(ours, turntable(known, moved, 4), strict=True):
        off = np.abs(a.astype(int) - b)
        assert off.mean() < 0.2 and np.percentile(off, 99) <= 3
    shown = (frame.on_background() < 0.98).any(2)  # the circle begins at the camera
    assert ((ours[0] < 250).any(2) & shown).sum() > 0.8 * shown.sum()
    assert np.abs(ours[0].astype(int) - ours[2]).mean() > 1
