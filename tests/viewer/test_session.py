"""The drawing loop: only the newest state, coarse first; snapshots and cameras."""

import resource
from dataclasses import replace

import numpy as np
import pytest

from gva_mi.body.pose import save_poses
from gva_mi.data.cameras import load_cameras
from gva_mi.data.pictures import read_image
from gva_mi.fit.renders import over, render_layer
from gva_mi.viewer.controls import Click
from gva_mi.viewer.drawing import Drawing
from gva_mi.viewer.session import COARSE, REST, Session
from gva_mi.viewer.state import State


@pytest.fixture
def out(tmp_path):
    return tmp_path / "out"


@pytest.fixture
def opened(drawing, panel, place, out):
    return Session(drawing, panel, place.up, out)


def press(opened, panel, page, *actions):
    """Press buttons of a page, one a step; return its messages."""
    for action in actions:
        panel.pressed = [Click(action, 7)]
        opened.step({7: page}, 0.0)
    return page.messages


def test_a_picture_is_coarse_first_and_then_as_rendered(known, motion, opened, panel, page, view):
    page.at = replace(view, width=900, height=600)  # more pixels than while something moves
    panel.now = State(frame=2)
    assert opened.step({7: page}, 0.0) == REST
    assert opened.step({7: page}, REST / 2) == REST
    assert opened.step({7: page}, REST) > REST
    opened.step({7: page}, 2 * REST)
    (coarse, first), (whole, second) = page.shown  # and nothing twice
    assert not first and second
    assert coarse.shape[0] * coarse.shape[1] <= COARSE and coarse.shape[0] / 600 > 0.5
    expected = over(render_layer(known, motion[2], page.at.to_camera()), np.ones(3, "f4"))
    assert np.array_equal(whole, expected)


def test_a_moving_browser_waits_for_its_fine_picture(opened, page, place, looking):
    opened.step({7: page}, 0.0)
    page.at = looking(place.position + 0.2 * place.up)
    opened.step({7: page}, 0.9 * REST)
    opened.step({7: page}, 1.5 * REST)
    assert [fine for _, fine in page.shown] == [False, False]
    opened.step({7: page}, 2 * REST)
    assert page.shown[-1][1] and np.array_equal(page.shown[-1][0], page.shown[1][0])


def test_each_browser_has_its_own_view_and_may_leave(opened, panel, page, view):
    other = type(page)(replace(view, width=40))
    opened.step({1: page, 2: other}, 0.0)
    opened.step({2: other}, 1.0)
    assert len(page.shown) == 1 and [fine for _, fine in other.shown] == [False, True]
    assert other.shown[1][0].shape == (64, 40, 3)
    hidden = type(page)(replace(view, width=0))
    opened.step({3: hidden}, 2.0)
    assert not hidden.shown


def test_a_snapshot_is_the_picture_or_transparent(known, motion, opened, panel, page, out):
    from PIL import Image

    panel.now = State(frame=1)
    press(opened, panel, page, "snapshot")
    panel.now = State(frame=1, transparent=True)
    messages = press(opened, panel, page, "snapshot")
    first, second = (out / f"snapshot_00{k}.png" for k in (0, 1))
    assert messages == [f"saved: {first}", f"saved: {second}"]
    layer = render_layer(known, motion[1], page.at.to_camera())
    assert np.array_equal(read_image(first, 3), over(layer, np.ones(3, "f4")))
    rgba = np.asarray(Image.open(second))
    assert np.array_equal(rgba[..., 3], np.round(255 * np.clip(layer[..., 3], 0, 1)))


def test_render_reads_the_saved_cameras_of_keyframes(
    known, motion, turning, opened, panel, page, place, looking, out, tmp_path, cli
):
    views = [page.at, looking(place.position + [2.0, 0.3, -1.0])]
    press(opened, panel, page, "add keyframe")
    page.at = views[1]
    messages = press(opened, panel, page, "add keyframe", "add keyframe", "remove keyframe")
    assert messages == [f"keyframes: {k}" for k in (1, 2, 3, 2)]
    assert panel.keyframes == 2
    press(opened, panel, page, "save cameras")
    path = out / "cameras_000.npz"
    cameras = load_cameras(path)
    assert len(cameras) == len(motion) and (cameras[0].width, cameras[0].height) == (80, 64)
    for camera, view in ((cameras[0], views[0]), (cameras[-1], views[1])):
        assert np.allclose(camera.T_camera_world, view.to_camera().T_camera_world, atol=1e-6)

    known.save(tmp_path / "avatar.npz")
    save_poses(tmp_path / "poses.npz", motion, turning(1)[1], stage=2)
    files = ("--poses", tmp_path / "poses.npz", "--cameras", path, "--out", tmp_path / "renders")
    cli.works("render", tmp_path / "avatar.npz", *files)
    panel.now = State(frame=2, seen_from="keyframes")
    opened.step({7: page}, 1.0)
    found = page.shown[-1][0]
    assert np.array_equal(found, read_image(tmp_path / "renders/000002.png", 3))


def test_after_a_full_disk_the_session_goes_on(opened, panel, page, out):
    action = "snapshot"
    messages = press(opened, panel, page, action)
    (first,) = out.iterdir()
    whole = first.read_bytes()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, before[1]))
    try:
        press(opened, panel, page, action)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    second = first.with_name(first.name.replace("000", "001"))
    assert messages[-1] == f"{second}: cannot be written (File too large)"
    assert list(out.iterdir()) == [first] and first.read_bytes() == whole
    press(opened, panel, page, action)
    assert messages[-1] == f"saved: {second}" and second.read_bytes() == whole


def test_beside_the_video_through_its_camera(known, video, panel, page, view, place, out):
    drawing = Drawing(known, video.pose, video)
    opened = Session(drawing, panel, place.up, out, video.cameras)
    page.at = replace(view, width=96, height=48)
    panel.now = State(frame=5, beside=True, seen_from="video", background=(77, 77, 77))
    opened.step({7: page}, 0.0)
    opened.step({7: page}, 1.0)
    left, right = np.split(page.shown[-1][0].astype(int), 2, axis=1)
    # The subject's pictures show this avatar in front of a grey of 0.3.
    assert np.abs(left - right).max() <= 2
    assert page.shown[0][0].shape == (48, 96, 3)
