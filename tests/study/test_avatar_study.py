"""A variant is fitted with what its name says; a run that no longer holds is not used."""

import shutil
from dataclasses import replace

import pytest
import torch

from gva_mi.avatar.avatar import AvatarOptions
from gva_mi.avatar.canonical import SeedOptions
from gva_mi.body.pose import load_poses, read_pose_file, save_poses
from gva_mi.data.cameras import save_cameras
from gva_mi.data.pictures import write_image
from gva_mi.fit.options import FitOptions, Schedule
from gva_mi.fit.photometric import PhotometricOptions
from gva_mi.fit.renders import render_frame, render_layer
from gva_mi.pose import SequenceOptions
from gva_mi.study import fitted_poses
from gva_mi.study.avatar_study import MADE_WITH, AvatarStudy, AvatarStudyOptions, VariantRun
from gva_mi.study.cases import TUNING
from gva_mi.study.engine import run_study
from gva_mi.study.metrics import load_metrics
from gva_mi.study.variants import FULL, NO_HANDS, VARIANTS, variants_named

OPTIONS = FitOptions(
    steps=2, window=16, avatar=AvatarOptions(seed=SeedOptions(count=300)),
    schedule=Schedule(reinit_at=()),
)  # fmt: skip


@pytest.fixture
def refined_subject(subject, tmp_path, body):
    """The tiny subject, refined to other poses than those of stage 1."""
    folder = shutil.copytree(subject, tmp_path / "subject")
    pose, shape = load_poses(folder / "poses.npz")
    pose.rotations[:, 3] += 0.05
    offsets = torch.full((len(body.v_template), 3), 0.001)
    save_poses(folder / "poses_refined.npz", pose, shape, stage=2, offsets=offsets)
    return folder


def run_of(name, subject, body):
    (variant,) = variants_named((name,))
    return VariantRun(subject, subject.parent / "run", variant, body, OPTIONS, "made")


def test_variants_open_the_poses_they_are_named_after(refined_subject, body):
    files = ("poses.npz", "poses_refined.npz")
    stage1, better = (load_poses(refined_subject / file)[0] for file in files)
    for name, pose in (("full", better), ("without either", stage1), ("GART-like", stage1)):
        video = run_of(name, refined_subject, body).video()
        assert torch.equal(video.pose.rotations, pose.rotations)
    assert run_of("one held-out range", refined_subject, body).video().splits.test == [2]
    assert run_of("full", refined_subject, body).video().splits.test == [3]


def test_a_rigid_body_turns_and_moves_as_a_whole(refined_subject, body):
    run, full = (run_of(name, refined_subject, body) for name in ("static 3DGS", "full"))
    video, whole = run.video(), full.video()
    assert torch.equal(video.pose.rotations[:, 0], whole.pose.rotations[:, 0])
    assert (video.pose.rotations[:, 1:] == whole.pose.rotations[0, 1:]).all()
    assert torch.equal(run.driven(video)(whole.pose).rotations, video.pose.rotations)
    assert full.driven(whole)(whole.pose) is whole.pose


def test_only_variants_with_refined_poses_are_seeded_on_the_displaced_surface(
    refined_subject, body
):
    naked = {
        variant.name
        for variant in VARIANTS
        if read_pose_file(run_of(variant.name, refined_subject, body)._poses).offsets is None
        or variant.of(OPTIONS).naked
    }
    assert naked == {
        "without refinement", "without either", "GART-like", "seeded on the naked body",
        "without re-initialisation, naked",
    }  # fmt: skip


def test_a_run_made_with_something_else_is_removed(refined_subject, body):
    run = run_of("full", refined_subject, body)
    run.out.mkdir()
    (run.out / MADE_WITH).write_text('{"version": 0}')
    (run.out / "checkpoint.pt").write_text("of another version")
    run._make_room()
    assert [path.name for path in run.out.iterdir()] == [MADE_WITH]
    (run.out / "checkpoint.pt").write_text("its own")
    run._make_room()
    assert (run.out / "checkpoint.pt").exists()


@pytest.fixture(scope="module")
def runs(subject, tmp_path_factory, body, known, camera, turning):
    """Two variants, on the tiny subject with novel poses and views of its own."""
    folder = tmp_path_factory.mktemp("study")
    case = shutil.copytree(subject, folder / "subject")
    shutil.copy(case / "poses.npz", case / "poses_refined.npz")
    for split in ("novel_pose", "novel_view"):
        part, (pose, shape) = case / "truth" / split, turning(2, start=0.7)
        for k in range(2):
            write_image(part / f"frames/{k:06d}.png", render_frame(known, pose[k], camera))
            alpha = render_layer(known, pose[k], camera)[..., 3]
            write_image(part / f"masks/{k:06d}.png", alpha)
        save_poses(part / "poses.npz", pose, shape, stage=0)
        save_cameras(part / "cameras.npz", [camera] * 2)
    for name in ("poses.npz", "cameras.npz"):
        shutil.copy(case / name, case / "truth" / name)
    made, few = {}, lambda frames: PhotometricOptions(passes=1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fitted_poses, "_pose_fit_options", few)
        for variant in (FULL, NO_HANDS):
            out = folder / "runs" / variant.name
            run = VariantRun(case, out, variant, body, OPTIONS, "made")
            made[variant.name] = (run, run.solve())
        yield made


def test_a_variant_is_fitted_and_measured_in_all_ways(runs):
    run, figures = runs["full"]
    for name in ("psnr: test", "psnr: test, as given", "psnr: test, poses fitted",
                 "psnr: novel pose, aligned", "psnr: novel view, poses fitted",
                 "psnr in boxes: test, person", "pose error, mm: body, trained"):  # fmt: skip
        assert figures[name] is not None, name
    row = next(row for row in load_metrics(run.out).rows if row.split == "test")
    assert figures["psnr: test"] == row.psnr and figures["cost: Gaussians"] >= 300
    without, _ = runs[NO_HANDS.name]
    assert without.avatar().options.hands is False and run.avatar().options.hands is True


def test_a_finished_variant_is_not_fitted_again(runs):
    run, figures = runs["full"]
    before = (run.out / "avatar.npz").stat().st_mtime_ns
    assert run.solve() == figures
    assert (run.out / "avatar.npz").stat().st_mtime_ns == before


@pytest.mark.slow
def test_a_small_study_runs_and_is_resumed(tmp_path, body):
    bare = next(case for case in TUNING if case.take.bare)
    options = AvatarStudyOptions(
        frames=8, size=64, novel=1, refine=SequenceOptions(size=64, passes=2),
        fit=FitOptions(steps=8, schedule=Schedule(densify_every=4)),
    )  # fmt: skip
    rows = variants_named(("full", "static 3DGS", "one held-out range"))
    study = AvatarStudy(tmp_path, body, options, rows)
    found = list(run_study(study, [bare]))
    figures = found[0].figures
    for name in ("psnr: novel view", "psnr: novel pose, aligned", "psnr: test, poses fitted",
                 "surface: spacing, before", "surface: spacing, end"):  # fmt: skip
        assert figures[name] is not None, name
    (again,) = run_study(replace(study, rows=rows[:1]), [bare])
    assert again.figures == figures
