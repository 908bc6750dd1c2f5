"""The folder of a subject: complete, exact without errors, reproducible, and degraded again."""

import json
import os
from dataclasses import replace

import numpy as np
import pytest
import torch

from gva_mi import InputError
from gva_mi.body.pose import load_poses
from gva_mi.subject.cameras import load_cameras
from gva_mi.subject.fingerprint import require_same_body
from gva_mi.subject.ground_truth import load_ground_truth
from gva_mi.subject.pictures import read_image
from gva_mi.subject.video import load_video
from gva_mi.subject.video_file import VideoFile
from gva_mi.synthetic import SynthOptions, degrade, make_subject, relit_pictures
from gva_mi.synthetic.errors.models import draw_errors

pytest.importorskip("mitsuba")
HELD = {"error_model": "none", "scene": "room", "camera": "held"}


@pytest.fixture(scope="module")
def exact(body, bare, tmp_path_factory):
    """A bare body without errors."""
    out = tmp_path_factory.mktemp("exact") / "subject"
    make_subject(out, replace(bare, error_model="none"), body)
    return out


def inside(mask, pixels, reach=0):
    """Return which pixels (V, 2) lie in a mask (H, W) or at most ``reach`` pixels beside it."""
    x, y = np.floor(pixels).astype(int).T
    assert (x >= reach).all() and (x < mask.shape[1] - reach).all()
    assert (y >= reach).all() and (y < mask.shape[0] - reach).all()
    near = range(-reach, reach + 1)
    return np.any([mask[y + dy, x + dx] > 0 for dx in near for dy in near], axis=0)


def assert_overlay(mask, pixels):
    """Points of the surface lie in the mask; rays may miss part of a pixel at the rim."""
    assert inside(mask, pixels).mean() > 0.985
    assert inside(mask, pixels, reach=1).all()


def test_the_folder_opens_as_a_video(noisy, body):
    video = load_video(noisy)
    assert len(video) == 3 and video.size == (64, 64) and video.normals
    assert video.truth == noisy / "truth"
    require_same_body(noisy, body)
    for k, image in enumerate(VideoFile(noisy / "video.mp4")):
        assert np.array_equal(image, read_image(noisy / f"frames/{k:06d}.png", 3))
    for frame in video.frames():
        assert 0.02 < frame.mask.mean() < 0.5
        assert (frame.image[frame.mask < 0.01].mean()) > 0.8


@pytest.mark.parametrize("part", ["truth", "truth/novel_pose", "truth/novel_view"])
def test_the_posed_body_lies_in_the_true_mask(exact, body, part):
    folder = exact / part
    pose, shape = load_poses(folder / "poses.npz")
    cameras = load_cameras((exact if part == "truth" else folder) / "cameras.npz")
    for k in range(len(pose)):
        camera = cameras[min(k, len(cameras) - 1)]
        mask = read_image(folder / f"masks/{k:06d}.png", 1)
        pixels = camera.project(body(pose[k], shape).vertices[0].double().numpy())
        assert_overlay(mask, pixels)


def test_a_subject_in_another_light_is_the_one_that_synth_makes(noisy, bare, body, tmp_path):
    make_subject(tmp_path / "lit", replace(bare, light="right", novel_views=0), body)
    (found,) = relit_pictures(noisy, body, "right", [2])
    stored, usual = (read_image(f / "frames/000002.png", 3) for f in (tmp_path / "lit", noisy))
    assert np.array_equal(np.round(found.color * 255), stored)
    assert (np.abs(found.color * 255 - usual).max(2) > 25).sum() > 0.2 * found.mask.sum()


def test_no_errors_are_exact(exact):
    truth, seen = load_poses(exact / "truth/poses.npz"), load_poses(exact / "poses.npz")
    for name in ("rotations", "transl", "expression"):
        assert torch.equal(getattr(truth[0], name), getattr(seen[0], name))
    assert torch.equal(truth[1].betas, seen[1].betas)
    for kind in ("masks", "normals"):
        for k in range(3):
            name = f"{kind}/{k:06d}.png"
            assert (exact / name).read_bytes() == (exact / "truth" / name).read_bytes()


def test_noise_does_not_touch_frames_or_truth(exact, noisy, files):
    a, b = files(exact), files(noisy)
    same = [name for name in a if name.startswith(("frames/", "truth/"))]
    assert len(same) > 10 and all(a[name] == b[name] for name in same)
    assert all(
        a[name] != b[name] for name in ("poses.npz", "masks/000001.png", "normals/000001.png")
    )


def test_splits_do_not_overlap(noisy):
    splits = json.loads((noisy / "splits.json").read_text())
    folders = (noisy, noisy / "truth/novel_view")
    (ours,), (other,) = (load_cameras(f / "cameras.npz") for f in folders)
    turned = ours.T_camera_world[:3, :3] @ other.T_camera_world[:3, :3].T
    assert np.arccos((np.trace(turned) - 1) / 2) > 0.3  # radians: nor is a novel view
    assert not set(splits["train"]) & set(splits["test"])
    assert sorted(splits["train"] + splits["test"]) == [0, 1, 2]
    assert splits["novel_pose"] == [0] and len(splits["novel_view"]) == 1


def test_a_foreign_person_has_poses_of_the_fitted_body_and_its_own_surface(body, bare, tmp_path):
    foreign = tmp_path / "foreign"
    make_subject(foreign, replace(bare, error_model="none", figure="stretched"), body)
    require_same_body(foreign, body)
    (camera,) = load_cameras(foreign / "cameras.npz")
    truth = load_ground_truth(foreign / "truth", body)
    pose, shape = load_poses(foreign / "poses.npz")
    away = body(pose, shape).joints - truth.body(truth.pose, truth.shape).joints
    floor = json.loads((foreign / "noise.json").read_text())["floor"]
    assert 0 < 1000 * away.norm(dim=-1).mean() == pytest.approx(floor["joint_mm"], abs=0.01)
    assert truth.foreign
    for k in range(3):
        vertices = truth.body(truth.pose[k], truth.shape).vertices[0]
        mask = read_image(foreign / f"truth/masks/{k:06d}.png", 1)
        assert_overlay(mask, camera.project(vertices.double().numpy()))


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_the_same_options_write_the_same_bits(noisy, body, bare, files, tmp_path, workers):
    make_subject(tmp_path / "again", replace(bare, workers=workers), body)
    assert files(noisy) == files(tmp_path / "again")


def test_a_camera_that_circles_sees_the_person_from_all_sides(body, bare, tmp_path):
    seen = {"frames": 4, "size": 32, "samples": 1, "novel_poses": 0, "novel_views": 0}
    options = replace(bare, seed=1, motion="still", camera="circles", error_model="none", **seen)
    make_subject(tmp_path / "round", options, body)
    video = load_video(tmp_path / "round")
    ahead = np.stack([camera.T_camera_world[2, :3] for camera in video.cameras])
    turns = (ahead @ ahead[0] - ahead[0, 1] ** 2) / (1 - ahead[0, 1] ** 2)
    np.testing.assert_allclose(turns, [1, 0, -1, 0], atol=1e-9)
    for frame in video.frames(range(4)):  # the person is where the camera looks
        rows, columns = np.nonzero(frame.mask > 0.5)
        assert abs(columns.mean() - 16) < 4 and np.ptp(rows) > 20
        place = body(frame.pose, video.shape).vertices[0].double().numpy()
        assert np.abs(frame.camera.project(place).mean(0) - (columns.mean(), rows.mean())).max() < 3


@pytest.mark.slow
def test_a_folder_of_a_room(body, bare, tmp_path):
    filmed = replace(
        bare, novel_views=0, error_model="none", scene="room", camera="held", shutter=0.05
    )
    for name, workers in (("room", 1), ("again", 2)):
        make_subject(tmp_path / name, replace(filmed, workers=workers), body)
    room, again = tmp_path / "room", tmp_path / "again"
    names = {str(path.relative_to(room)) for path in room.rglob("*") if path.is_file()}
    assert all((room / name).read_bytes() == (again / name).read_bytes() for name in names)
    video, recording = load_video(room), VideoFile(room / "phone.mp4")
    assert len(video) == len(recording) == 3
    pose, shape = load_poses(room / "truth/poses.npz")
    for k, frame in enumerate(video.frames()):
        beside = frame.image[frame.mask < 0.01]
        assert (beside > 0.97).mean() < 0.5 and beside.std() > 0.03  # not white
        assert np.abs(recording[k] / 255 - frame.image).mean() < 0.05
        # The true pose is that of the middle of the exposure, and no pixel of it is cut off.
        camera = load_cameras(room / "truth/cameras.npz")[k]
        column, row = camera.project(body(pose[k], shape).vertices[0].double().numpy()).T
        seen = frame.mask[row.astype(int), column.astype(int)]
        assert (seen > 0).mean() > 0.97
    held_out = read_image(room / "truth/novel_pose/frames/000000.png", 3)
    mask = read_image(room / "truth/novel_pose/masks/000000.png", 1)
    assert (held_out[mask == 0] == 255).all()
    about = json.loads((room / "truth/person.json").read_text())
    y = body.rest(shape).vertices[:, 1]
    assert about["height_m"] == pytest.approx(float(y.max() - y.min()), abs=1e-5)


@pytest.fixture(scope="module")
def degraded(noisy, body, tmp_path_factory):
    """Return a function that degrades the recording by an error model, once."""
    folder = tmp_path_factory.mktemp("degraded")

    def made(error_model):
        if not (folder / error_model).exists():
            degrade(noisy, folder / error_model, error_model, 7, body)
        return folder / error_model

    return made


def test_it_equals_make_subject_and_links_its_frames(noisy, degraded, body, bare, files, tmp_path):
    make_subject(tmp_path / "made", replace(bare, error_model="normals", error_seed=7), body)
    assert files(tmp_path / "made") == files(degraded("normals"))
    for path in sorted(noisy.rglob("*")):
        name = path.relative_to(noisy)
        if path.is_file() and name.parts[0] in ("frames", "truth", "video.mp4"):
            assert os.path.samefile(path, degraded("normals") / name), name


def test_the_estimated_and_the_true_camera_are_written(noisy, degraded):
    factor = 1 + draw_errors("focal", 7).pose.focal
    paths = (degraded("focal") / "truth", degraded("focal"), noisy)
    (true,), (estimated,), (before,) = (load_cameras(path / "cameras.npz") for path in paths)
    assert (true.K == before.K).all() and factor != 1
    assert (true.T_camera_world == estimated.T_camera_world).all()
    assert (estimated.fx, estimated.fy) == pytest.approx((factor * true.fx, factor * true.fy))


def test_other_folders_are_refused(noisy, body, tmp_path):
    with pytest.raises(InputError, match="synth.json: no such file; expected a folder that gva-mi"):
        degrade(tmp_path, tmp_path / "out", "white", 0, body)
    with pytest.raises(InputError, match="already exists"):
        degrade(noisy, noisy, "white", 0, body)
    (tmp_path / "synth.json").write_text('{"options": {"colour": 1}}')
    with pytest.raises(InputError, match="synth.json: unexpected format"):
        degrade(tmp_path, tmp_path / "out", "white", 0, body)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("options, sentence",
    [({"samples": 5}, "samples must be a square number, got 5"),
    ({"samples": 9, "shutter": 0.05}, "4 times a square number with a shutter, got 9"),
    ({"subject": "zoe"}, "amira, bruno"), ({"motion": "crawl"}, "everyday"),
    ({"scene": "garden"}, "no scene 'garden'; there are: white, room"),
    ({"error_model": "brown"}, "no error model 'brown'; there are: none, bursts, white"),
    ({"error_seed": -1}, "error_seed must be from 0 to .*, got -1"),
    ({"camera": "circles"}, "--camera circles needs --error-model none"),
    (HELD | {"error_model": "white"}, "--camera held needs --error-model none"),
    (HELD | {"scene": "white"}, "--camera held needs --scene room"),
    (HELD | {"camera": "circles"}, "--camera circles needs --scene white")])  # fmt: skip
def test_bad_options_are_refused(options, sentence):
    with pytest.raises(InputError, match=sentence):
        SynthOptions(**options)


def test_a_stopped_subject_leaves_nothing(body, bare, tmp_path):
    def stop(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_subject(tmp_path / "subject", bare, body, stop)
    assert not list(tmp_path.iterdir())
