"""A similarity transform is found again, and changes no pixel where it should not."""

from dataclasses import replace

import numpy as np
import pytest
import roma
import torch

from gva_mi.body.pose import Pose, save_poses
from gva_mi.evaluate.figures import where
from gva_mi.evaluate.measure import (
    ALIGNED,
    _under_fitted_poses,
    aligned_views,
    evaluate_views,
    views_of,
)
from gva_mi.evaluate.scores import Scorer
from gva_mi.evaluate.similarity import (
    Similarity,
    _about_the_eye,
    _stance,
    in_avatars_world,
    posed_joints,
    similarity_to_truth,
    zoomed,
)
from gva_mi.fit.perceptual import Weights
from gva_mi.fit.photometric import FITTED
from gva_mi.subject.cameras import save_cameras
from gva_mi.subject.video import load_video

TURN = roma.rotvec_to_rotmat(torch.tensor([0.1, -0.4, 0.2], dtype=torch.float64)).numpy()
KNOWN = Similarity(1.25, TURN, np.array([0.3, -0.2, 0.9]))


def test_a_camera_sees_the_same_pixels_in_both_worlds(camera):
    x = np.random.default_rng(3).uniform(-0.5, 0.5, (20, 3))
    seen = KNOWN.camera(camera).project(x)
    np.testing.assert_allclose(seen, camera.project(KNOWN(x)), atol=1e-9)


@pytest.fixture
def moved(studio, known, body, tmp_path):
    """The studio as it is with true poses, of which the given ones differ by the similarity.

    Between its frames the person turns by a right angle: all sides of a stance are seen."""
    import shutil

    folder = tmp_path / "moved"
    shutil.copytree(studio.folder, folder)
    rotations = studio.pose.rotations.clone()
    rotations[1, 0, 1] = torch.pi / 2
    true = replace(studio.pose, rotations=rotations)
    save_poses(folder / "truth/poses.npz", true, studio.shape, stage=0)
    save_cameras(folder / "truth/cameras.npz", studio.cameras)
    unscaled = replace(KNOWN, scale=1.0)
    pelvis = known.rig.joints[0].double()
    pose = unscaled.pose(true, pelvis, pelvis)
    save_poses(folder / "poses.npz", pose, studio.shape, stage=1)
    save_cameras(folder / "cameras.npz", [unscaled.camera(c) for c in studio.cameras])
    (folder / "splits.json").write_text('{"train": [0, 1], "test": []}')
    return load_video(folder), unscaled


def test_the_similarity_to_the_ground_truth_is_recovered(moved, known, body):
    video, unscaled = moved
    found = similarity_to_truth(known.rig, video, body)
    assert found.scale == pytest.approx(1, abs=1e-5)
    np.testing.assert_allclose(found.rotation, unscaled.rotation, atol=1e-4)
    np.testing.assert_allclose(found.translation, unscaled.translation, atol=1e-4)
    np.testing.assert_allclose(found.stance, 0, atol=1e-5)


def test_scale_is_about_the_eye_of_a_static_camera(studio, known, body, tmp_path):
    """All joints lie on the same rays; the scale is about the eye."""
    true = posed_joints(known.rig, studio.pose).double().numpy()
    camera = studio.cameras[0]
    away = camera.position + 1.1 * (true - camera.position)
    found = _about_the_eye(away.reshape(-1, 3), true.reshape(-1, 3), camera, camera)
    assert found.scale == pytest.approx(1 / 1.1) and np.allclose(found.rotation, np.eye(3))
    np.testing.assert_allclose(found(away), true, atol=1e-9)
    np.testing.assert_allclose(camera.project(found(away)), camera.project(away), atol=1e-6)


def test_a_skeleton_offset_inside_the_surface_is_removed(moved, known, body):
    """3 cm too low and 2 behind in each frame, as the person turns: Gaussians may lie so, too."""
    video, _ = moved
    off = torch.tensor([0.0, -0.03, -0.02])
    root = roma.rotvec_to_rotmat(video.pose.rotations[:, 0])
    pose = Pose(video.pose.rotations, video.pose.transl + root @ off, video.pose.expression)
    similarity = similarity_to_truth(known.rig, replace(video, pose=pose), body)
    np.testing.assert_allclose(similarity.stance, off, atol=5e-4)  # scale takes the rest
    source = load_video(video.truth / "novel_pose")
    strict = replace(similarity, stance=np.zeros(3))
    with_it, without = (
        in_avatars_world(s, source, known.rig, body).pose for s in (similarity, strict)
    )
    stance = torch.from_numpy(similarity.stance).float()
    shift = roma.rotvec_to_rotmat(with_it.rotations[:, 0]) @ stance
    torch.testing.assert_close(with_it.transl - without.transl, shift, atol=1e-6, rtol=0)


def test_depth_errors_do_not_change_the_stance():
    """Errors along the camera's axis, centimetres here, say nothing about it."""
    rng = np.random.default_rng(4)
    about_y = torch.zeros(40, 3, dtype=torch.float64)
    about_y[:, 1] = torch.linspace(0, 6, 40)
    root = roma.rotvec_to_rotmat(about_y).numpy()
    z, o = np.tile([0.0, 0.6, 0.8], (40, 1)), np.array([0.004, -0.03, 0.02])
    deep = 0.05 * rng.standard_normal((40, 1)) * z
    np.testing.assert_allclose(_stance(root @ o + deep, root, z), o, atol=1e-12)


def test_novel_poses_in_the_avatars_world_show_the_same_pictures(moved, known, body):
    video, _ = moved
    similarity = similarity_to_truth(known.rig, video, body)
    views = views_of(video, body=body)
    own = [view for view in views if view.split == "novel_pose"]
    aligned = aligned_views(views, similarity, known.rig, body)
    before, after = (evaluate_views(known, some, Scorer(Weights())) for some in (own, aligned))
    pictures = [replace(one, alignment=ALIGNED) for one in where(before, metric="pictures")]
    assert pictures == where(after, metric="pictures")
    for one, other in zip(*(where(x, metric="PSNR, dB") for x in (before, after)), strict=True):
        # Equal but for float32: here and there a pixel falls to the next of 256 levels.
        assert one.region == other.region and min(one.value, other.value) > 50
        assert other.value == pytest.approx(one.value, rel=0.15)


def test_a_wrong_lens_is_undone(moved, known, body):
    """Poses that a longer lens puts farther away: pictures of the true camera are found again."""
    video, _ = moved
    pelvis = known.rig.joints[0]
    pose, cameras = zoomed(video.pose, pelvis, video.cameras, 1.4)
    center = lambda some: (pelvis + some.transl).double().numpy()
    for k, (long, short) in enumerate(zip(cameras, video.cameras, strict=True)):
        seen = long.project(center(pose)[k])
        np.testing.assert_allclose(seen, short.project(center(video.pose)[k]), atol=1e-3)
    longer = replace(video, pose=pose, cameras=list(cameras))
    found = similarity_to_truth(known.rig, longer, body)
    assert found.zoom == pytest.approx(1.4) and found.scale == pytest.approx(1, abs=1e-5)
    source = load_video(video.truth / "novel_pose")
    aligned = in_avatars_world(found, source, known.rig, body)
    before, after = (v.cameras[0].project(center(v.pose)[0]) for v in (source, aligned))
    np.testing.assert_allclose(after, before, atol=0.01)


def test_fitted_novel_poses_correct_a_skeleton_offset(moved, known, body):
    """The true poses, 2 cm beside what the pictures show: a figure of the skeleton, not of the
    avatar. What is fitted to them sees the avatar, which is the very one they were made with."""
    video, _ = moved
    folder = video.truth / "novel_pose"
    source = load_video(folder)
    off = torch.tensor([0.02, -0.01, 0.0]).expand(len(source), 3)
    shifted = Pose(source.pose.rotations, source.pose.transl + off, source.pose.expression)
    save_poses(folder / "poses.npz", shifted, source.shape, stage=0)
    similarity = similarity_to_truth(known.rig, video, body)
    views = aligned_views(views_of(video, body=body), similarity, known.rig, body)
    protocol = {"seen": {"test pictures": ["stage 1"], "test masks": []}}
    fitted = _under_fitted_poses(known, [], views, protocol, None, workers=1)
    figures = evaluate_views(known, [*views, *fitted], Scorer(Weights()))
    before, after = where(figures, region="white", metric="PSNR, dB")
    assert after.split == before.split == "novel_pose" and after.value > before.value + 3
    assert (before.alignment, after.alignment) == (ALIGNED, FITTED)
    assert protocol["pose_fit"]["kept"] == {} and set(protocol["pose_fit"]["options"]) == {
        "novel_pose"
    }
    assert protocol["seen"] == {  # nobody looked at a test frame, for there is none
        "test pictures": ["stage 1"], "test masks": [],
        "novel pictures": [FITTED], "novel masks": [FITTED],
    }  # fmt: skip
