"""The folder of a subject: complete, exact where it says so, and the same for the same seed."""

import json
from typing import get_args, get_type_hints

import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view

from gva_mi import InputError
from gva_mi.body.pose import load_poses
from gva_mi.body.smplx import load_body
from gva_mi.data.film import Film
from gva_mi.data.fingerprint import fingerprint, require_same_body
from gva_mi.data.pictures import read_image
from gva_mi.data.synthetic import STUDY, SynthOptions, describe_noise, make_subject
from gva_mi.data.synthetic.motion import turn
from gva_mi.data.synthetic.render import LIGHTS, Renderer, camera_around
from gva_mi.data.synthetic.subject import draw_subject
from gva_mi.data.truth import load_truth
from gva_mi.data.video import load_cameras, load_video

pytest.importorskip("mitsuba")
BARE = dict(
    frames=3, size=64, samples=16, clothes=False, hair=False, novel_poses=1, novel_views=1
)  # fmt: skip


@pytest.fixture(scope="module")
def body():
    return load_body()


@pytest.fixture(scope="module")
def exact(body, tmp_path_factory):
    """A bare body without noise."""
    out = tmp_path_factory.mktemp("exact") / "subject"
    make_subject(out, SynthOptions(noise=0.0, **BARE), body)
    return out


@pytest.fixture(scope="module")
def noisy(body, tmp_path_factory):
    """A bare body with noise."""
    out = tmp_path_factory.mktemp("noisy") / "subject"
    make_subject(out, SynthOptions(**BARE), body)
    return out


def files(folder):
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def inside(mask, pixels, reach=0):
    """Which of some pixels (V, 2) lie in a mask (H, W), or at most ``reach`` pixels beside it."""
    x, y = np.floor(pixels).astype(int).T
    assert (x >= reach).all() and (x < mask.shape[1] - reach).all()
    assert (y >= reach).all() and (y < mask.shape[0] - reach).all()
    near = range(-reach, reach + 1)
    return np.any([mask[y + dy, x + dx] > 0 for dx in near for dy in near], axis=0)


def assert_overlay(mask, pixels):
    """Points of the surface lie in the mask; rays may miss the sliver of a pixel at the rim."""
    assert inside(mask, pixels).mean() > 0.985
    assert inside(mask, pixels, reach=1).all()


def test_the_folder_opens_as_a_video(noisy):
    video = load_video(noisy)
    assert len(video) == 3 and video.size == (64, 64) and video.has_normals
    assert video.truth == noisy / "truth"
    for frame in video.frames():
        assert 0.02 < frame.mask.mean() < 0.5
        assert (frame.image[frame.mask < 0.01].mean()) > 0.8


def test_the_movie_holds_the_frames_to_the_bit(noisy):
    for k, image in enumerate(Film(noisy / "video.mp4")):
        assert np.array_equal(image, read_image(noisy / f"frames/{k:06d}.png", 3))


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
        filled = np.zeros(mask.shape, bool)
        x, y = np.floor(pixels).astype(int).T
        filled[y, x] = True
        assert filled[mask == 255].mean() > 0.8  # the vertices fill it, too


def test_level_zero_is_exact(exact):
    truth, seen = load_poses(exact / "truth/poses.npz"), load_poses(exact / "poses.npz")
    assert np.array_equal(truth[0].rotations, seen[0].rotations)
    assert np.array_equal(truth[0].transl, seen[0].transl)
    assert np.array_equal(truth[1].betas, seen[1].betas)
    for kind in ("masks", "normals"):
        for k in range(3):
            name = f"{kind}/{k:06d}.png"
            assert (exact / name).read_bytes() == (exact / "truth" / name).read_bytes()
    statistics = json.loads((exact / "noise.json").read_text())
    assert statistics["pose"]["vertex_mm"] == 0 and statistics["mask"]["iou"] == 1


def test_noise_does_not_touch_frames_or_truth(exact, noisy):
    a, b = files(exact), files(noisy)
    same = [name for name in a if name.startswith(("frames/", "truth/"))]
    assert len(same) > 10 and all(a[name] == b[name] for name in same)
    assert all(
        a[name] != b[name] for name in ("poses.npz", "masks/000001.png", "normals/000001.png")
    )
    assert json.loads((noisy / "noise.json").read_text())["pose"]["vertex_mm"] > 10


def test_same_seed_same_bits_and_another_seed_another_video(noisy, body, tmp_path):
    make_subject(tmp_path / "again", SynthOptions(**BARE), body)
    make_subject(tmp_path / "other", SynthOptions(seed=1, **BARE), body)
    a, again, other = (files(f) for f in (noisy, tmp_path / "again", tmp_path / "other"))
    assert a == again
    assert a.keys() == other.keys() and a["frames/000000.png"] != other["frames/000000.png"]


def test_splits_do_not_overlap(noisy):
    splits = json.loads((noisy / "splits.json").read_text())
    video, _ = load_poses(noisy / "truth/poses.npz")
    novel, _ = load_poses(noisy / "truth/novel_pose/poses.npz")
    away = (video.rotations[:, None, 1:22] - novel.rotations[None, :, 1:22]).norm(dim=-1)
    assert away.amax(-1).min() > 0.2  # radians: no novel pose is in the video
    (ours,), (other,) = (load_cameras(f / "cameras.npz") for f in views(noisy))
    turned = ours.T_camera_world[:3, :3] @ other.T_camera_world[:3, :3].T
    assert np.arccos((np.trace(turned) - 1) / 2) > 0.3  # radians: nor is a novel view
    assert not set(splits["train"]) & set(splits["test"])
    assert sorted(splits["train"] + splits["test"]) == [0, 1, 2]
    assert splits["novel_pose"] == [0] and len(splits["novel_view"]) == 1


def views(folder):
    return folder, folder / "truth/novel_view"


def test_the_principal_point_lies_off_the_middle(noisy):
    for folder in views(noisy):
        for camera in load_cameras(folder / "cameras.npz"):
            assert abs(camera.cx / camera.width - 0.5) > 0.01
            assert abs(camera.cy / camera.height - 0.5) > 0.01


def test_the_folder_knows_its_body(noisy, body):
    require_same_body(noisy, body)
    assert json.loads((noisy / "synth.json").read_text())["body"] == fingerprint(body)


def test_nothing_is_written_over_and_nothing_half_written_stays(noisy, body, tmp_path):
    with pytest.raises(InputError, match="already there"):
        make_subject(noisy, SynthOptions(**BARE), body)

    def stop(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_subject(tmp_path / "subject", SynthOptions(**BARE), body, stop)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name, value", [("frames", 1), ("size", 8), ("samples", 5), ("noise", -1)])
def test_bad_options_are_named(name, value):
    with pytest.raises(InputError, match=name):
        SynthOptions(**{name: value})


def test_background_blur_and_sensor_noise_are_in_the_frames_alone(exact, body, tmp_path):
    out = tmp_path / "room"
    options = SynthOptions(noise=0.0, background=True, blur=1.0, sensor_noise=1.0, **BARE)
    make_subject(out, options, body)
    a, b = files(exact), files(out)
    changed = {name for name in a if a[name] != b[name]}
    assert changed == {"synth.json", "video.mp4", *(f"frames/{k:06d}.png" for k in range(3))}
    outside = read_image(out / "masks/000000.png", 1) == 0
    assert read_image(out / "frames/000000.png", 3)[outside].std() > 10


@pytest.fixture(scope="module")
def foreign(body, tmp_path_factory):
    """A person that the body does not span, without noise."""
    out = tmp_path_factory.mktemp("foreign") / "subject"
    make_subject(out, SynthOptions(noise=0.0, figure="stretched", **BARE), body)
    return out


def test_a_foreign_figure_is_the_one_in_the_pictures(foreign, body):
    truth = load_truth(foreign / "truth", body)
    assert truth.foreign
    (camera,) = load_cameras(foreign / "cameras.npz")
    for k in range(3):
        vertices = truth.body(truth.pose[k], truth.shape).vertices[0]
        mask = read_image(foreign / f"truth/masks/{k:06d}.png", 1)
        assert_overlay(mask, camera.project(vertices.double().numpy()))


def test_its_poses_are_those_of_the_fitted_body(foreign, body):
    require_same_body(foreign, body)
    truth, (pose, shape) = load_truth(foreign / "truth", body), load_poses(foreign / "poses.npz")
    away = body(pose, shape).joints - truth.body(truth.pose, truth.shape).joints
    floor = json.loads((foreign / "noise.json").read_text())["floor"]
    assert 0 < 1000 * away.norm(dim=-1).mean() == pytest.approx(floor["joint_mm"], abs=0.01)
    assert "as near as" in describe_noise(foreign)[-1]


def test_the_noise_is_described(noisy, exact):
    lines = describe_noise(noisy)
    assert len(lines) == 4 and lines[0] == "noise: family bursts, seed 0"
    assert "hands" in lines[1] and "IoU" in lines[2] and "degrees" in lines[3]
    assert "body 0 mm" in describe_noise(exact)[1]


@pytest.mark.slow
def test_any_number_of_workers_writes_the_same_bits(noisy, body, tmp_path):
    make_subject(tmp_path / "two", SynthOptions(workers=2, **BARE), body)
    assert files(noisy) == files(tmp_path / "two")


@pytest.mark.slow
@pytest.mark.parametrize("name", STUDY)
def test_a_dressed_subject_keeps_every_law(body, tmp_path, name):
    """At level 0: the true body lies in the true mask; frames and masks agree."""
    out = tmp_path / "subject"
    options = SynthOptions(
        subject=name, motion="everyday", frames=2, size=256, samples=16, novel_poses=2,
        novel_views=1, noise=0.0,
    )  # fmt: skip
    make_subject(out, options, body)
    for part in ("truth", "truth/novel_pose", "truth/novel_view"):
        pose, shape = load_poses(out / part / "poses.npz")
        cameras = load_cameras((out if part == "truth" else out / part) / "cameras.npz")
        frames = out if part == "truth" else out / part
        for k in range(len(pose)):
            mask = read_image(out / part / f"masks/{k:06d}.png", 1)
            camera = cameras[min(k, len(cameras) - 1)]
            pixels = camera.project(body(pose[k], shape).vertices[0].double().numpy())
            assert inside(mask, pixels).mean() >= 0.995
            image = read_image(frames / f"frames/{k:06d}.png", 3)
            assert (image[mask == 0] == 255).all()
            # Blended by the mask: never darker than black would be, and never all white inside.
            soft = 255 - mask.astype(int)[..., None]
            assert (image >= soft - 2).all() and (image[mask == 255].min(1) < 250).mean() > 0.99
            seen = read_image(out / part / f"normals/{k:06d}.png", 3)[mask > 0].astype(float)
            length = np.linalg.norm(seen / 127.5 - 1, axis=1)
            assert np.abs(length - 1).max() < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("name", STUDY)
def test_a_dressed_subjects_normals_are_the_slopes_of_its_depth(body, name):
    subject = draw_subject(body, STUDY[name])
    pose = turn(np.array([0.1]), body.num_expressions, np.random.default_rng(0))
    surface = subject.posed(body, pose, folds=1.0)[0]
    camera = camera_around(surface, 320, azimuth=0.6)
    picture = Renderer(subject)(surface, camera, samples=16)
    y, x = np.mgrid[:320, :320] + 0.5
    rays = [(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)]
    points = np.stack(rays, axis=-1) * picture.depth[..., None]
    across = np.cross(points[2:, 1:-1] - points[:-2, 1:-1], points[1:-1, 2:] - points[1:-1, :-2])
    across /= np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-12)
    normals = picture.normals[1:-1, 1:-1]
    # Where the picture shows one surface, not too steep: differences over its edges mean nothing.
    window = sliding_window_view(picture.depth, (3, 3))
    flat = (
        (np.ptp(window, axis=(2, 3)) < 0.02) & (window.min((2, 3)) > 0) & (normals[..., 2] < -0.5)
    )
    angle = np.degrees(np.arccos(np.clip((across * normals).sum(-1)[flat], -1, 1)))
    assert flat.sum() > 3000
    assert np.median(angle) < 5 and (angle < 20).mean() > 0.95


def test_light_changes_pictures_and_nothing_else(body, tmp_path):
    assert set(LIGHTS) == set(get_args(get_type_hints(SynthOptions)["light"]))
    folders = []
    for light in ("usual", "ambient"):
        options = SynthOptions(
            seed=1, frames=2, size=32, samples=1, novel_poses=0, novel_views=0, clothes=False,
            hair=False, light=light,
        )  # fmt: skip
        make_subject(tmp_path / light, options, body)
        folders.append(files(tmp_path / light))
    a, b = folders
    assert a["frames/000001.png"] != b["frames/000001.png"]
    assert a["masks/000001.png"] == b["masks/000001.png"] and a["poses.npz"] == b["poses.npz"]


def test_a_camera_that_circles_sees_the_person_from_all_sides(body, tmp_path):
    options = SynthOptions(
        seed=1, frames=4, size=32, samples=1, novel_poses=0, novel_views=0, clothes=False,
        hair=False, motion="still", camera="circles", noise=0,
    )  # fmt: skip
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


def test_noise_is_refused_where_the_camera_circles():
    with pytest.raises(InputError, match="circles needs noise 0"):
        SynthOptions(camera="circles")


@pytest.mark.slow
def test_folds_move_cloth_and_leave_the_body(body, tmp_path):
    folders = []
    for folds in (0.0, 1.0):
        out = tmp_path / f"folds{folds:g}"
        options = SynthOptions(
            subject="chen", frames=2, size=96, samples=4, novel_poses=0, novel_views=0, folds=folds
        )
        make_subject(out, options, body)
        folders.append(files(out))
    a, b = folders
    assert a["truth/poses.npz"] == b["truth/poses.npz"]
    assert a["frames/000001.png"] != b["frames/000001.png"]
