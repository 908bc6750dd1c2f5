"""Rows of a tiny subject are fitted, measured, and shown beside the truth."""

import shutil
from dataclasses import replace

import pytest

from gva_mi.avatar.avatar import AvatarOptions
from gva_mi.avatar.canonical import SeedOptions
from gva_mi.body.pose import save_poses
from gva_mi.data.pictures import write_image
from gva_mi.data.video import save_cameras
from gva_mi.fit.evaluation.metrics import AS_REFINED
from gva_mi.fit.evaluation.regions import CLOSE_UPS
from gva_mi.fit.evaluation.row_run import RowRun
from gva_mi.fit.evaluation.rows import FULL, NO_HANDS, NO_REFINEMENT, NO_REINIT_NAKED, TRUE
from gva_mi.fit.evaluation.study_pictures import CaseRuns, sections_of_pictures
from gva_mi.fit.options import FitOptions, Schedule
from gva_mi.fit.photometric import FITTED
from gva_mi.fit.renders import render_frame

OPTIONS = FitOptions(
    steps=2, window=16, avatar=AvatarOptions(seed=SeedOptions(count=300)),
    schedule=Schedule(reinit_at=()),
)  # fmt: skip


@pytest.fixture(scope="module")
def runs(subject, tmp_path_factory, body, known, camera, turning):
    """Two rows, on the tiny subject with refined poses and a novel pose of its own."""
    folder = tmp_path_factory.mktemp("study")
    case = shutil.copytree(subject, folder / "subject")
    shutil.copy(case / "poses.npz", case / "poses_refined.npz")
    for split in ("novel_pose", "novel_view"):
        part, (pose, shape) = case / "truth" / split, turning(2, start=0.7)
        for k in range(2):
            write_image(part / f"frames/{k:06d}.png", render_frame(known, pose[k], camera))
            write_image(part / f"masks/{k:06d}.png", known_mask(known, pose[k], camera))
        save_poses(part / "poses.npz", pose, shape, stage=0)
        save_cameras(part / "cameras.npz", [camera] * 2)
    for name in ("poses.npz", "cameras.npz"):
        shutil.copy(case / name, case / "truth" / name)
    made = {}
    for row in (FULL, NO_HANDS):
        run = RowRun(case, folder / "runs" / row.name, row, body, OPTIONS, {"sources": "a"})
        made[row.name] = (run, run.solve())
    return made


def known_mask(avatar, pose, camera):
    import torch

    from gva_mi.fit.renders import to_8bit
    from gva_mi.splat import render

    with torch.no_grad():
        return to_8bit(render(avatar(pose), camera).alpha.numpy())


def test_a_row_is_fitted_and_measured_in_all_ways(runs):
    run, metrics = runs["full"]
    names = {(row.name, row.split) for row in metrics.rows}
    assert {("full", "train"), ("full", "test"), ("full", "novel_pose")} <= names
    assert {(AS_REFINED, "test"), (FITTED, "test")} <= names
    assert {(FITTED, "novel_pose"), (FITTED, "novel_view")} <= names
    assert metrics.protocol.seen["novel pictures"] == [FITTED]
    assert metrics.training.steps == 2 and run.is_done
    without, _ = runs[NO_HANDS.name]
    assert without.avatar().options.hands is False and run.avatar().options.hands is True


def test_a_finished_row_is_not_fitted_again(runs):
    run, metrics = runs["full"]
    before = (run.out / "avatar.npz").stat().st_mtime_ns
    assert run.solve().rows == metrics.rows
    assert (run.out / "avatar.npz").stat().st_mtime_ns == before


def test_the_figures_whose_rows_were_made_are_shown(runs):
    cases = [CaseRuns("somebody", {name: run for name, (run, _) in runs.items()})]
    found = {section.title: section for section in sections_of_pictures(cases)}
    assert list(found) == ["Novel views (as Figure 5)", "The hand skeleton (as Figure 10)"]
    assert len(found["Novel views (as Figure 5)"].pictures) == 2
    captions = [p.caption for p in found["The hand skeleton (as Figure 10)"].pictures]
    assert all(c == "somebody, frame 3: truth, without hand skeleton, full" for c in captions)


def test_all_figures_are_shown_where_all_rows_are_there(runs):
    (run, _) = runs["full"]
    every = {
        row.name: replace(run, row=replace(FULL, name=row.name))
        for row in (FULL, NO_HANDS, NO_REFINEMENT, NO_REINIT_NAKED, TRUE)
    }
    sections = list(sections_of_pictures([CaseRuns("somebody", every)]))
    assert [section.title.split("as ")[-1] for section in sections] == [
        "Figure 5)", "Figure 2)", "Figure 10)", "Figure 11)", "Figure 12)", "Closer"
    ]  # fmt: skip
    parts = [p.caption.split(", ")[2].split(":")[0] for p in sections[-1].pictures]
    assert parts and set(parts) <= set(CLOSE_UPS)


def test_a_case_without_runs_shows_nothing():
    assert list(sections_of_pictures([CaseRuns("nobody", {})])) == []
