"""The study of the avatar: rows and cases are computed once, and a run that holds no longer is not
used."""

import json
import shutil

import pytest
import torch

from gva_mi.body.pose import load_poses, save_poses
from gva_mi.fit.evaluation import study as studies
from gva_mi.fit.evaluation.evaluate import SplitScores
from gva_mi.fit.evaluation.metrics import Metrics, Protocol, Training
from gva_mi.fit.evaluation.row_run import MADE_WITH, RowRun
from gva_mi.fit.evaluation.rows import FULL, ROWS, rows_named
from gva_mi.fit.evaluation.study import AvatarStudyOptions, RowResult, study
from gva_mi.fit.options import FitOptions, Schedule
from gva_mi.pose import SequenceOptions
from gva_mi.pose.evaluation.cases import HELD_OUT, TUNING
from gva_mi.pose.evaluation.figures import PoseFigures

AMIRA = [case for case in TUNING if case.take.person == "amira"]


def metrics(name):
    return Metrics(
        (SplitScores(name, "test", 30.0, 0.9, None, 0.1, "white", 8),),
        PoseFigures(), Training(10, 1.0, 500, (64, 64)), {}, {},
        Protocol({"lpips": None}, "rand_vgg", "true", {}),
    )  # fmt: skip


@pytest.fixture
def done(monkeypatch):
    """As if people were filmed and rows were fitted at once; keeps what was."""
    made = {"cases": [], "rows": []}

    def film(work, progress=None):
        made["cases"].append([case.name for case in work.cases])

    def fit(work, progress=None):
        made["rows"].append((work.out.parent.name, work.row.name))
        return metrics(work.row.name)

    monkeypatch.setattr(studies.Recording, "solve", film)
    monkeypatch.setattr(studies.RowRun, "solve", fit)
    return made


def test_a_take_is_one_piece_of_work_and_known_rows_are_none(done, tmp_path, body):
    cases, rows = [*AMIRA, TUNING[1]], rows_named(("full", "true poses"))
    known = [RowResult.of(AMIRA[0], rows[0], metrics("full"))]
    options = AvatarStudyOptions()
    found = list(study(tmp_path, cases, rows, body, options, known))
    assert [(r.case, r.row) for r in found] == [(c, row.name) for c in cases for row in rows]
    assert found[0] is known[0]
    assert done["cases"] == [[case.name for case in AMIRA], [TUNING[1].name]]
    assert len(done["rows"]) == len(set(done["rows"])) == 2 * len(cases) - 1


def test_a_known_case_is_not_filmed(done, tmp_path, body):
    known = [RowResult.of(case, FULL, metrics("full")) for case in AMIRA]
    assert list(study(tmp_path, AMIRA, [FULL], body, AvatarStudyOptions(), known)) == known
    assert done == {"cases": [], "rows": []}


def test_progress_counts_up_to_all_of_the_work(done, tmp_path, body):
    seen = []
    progress = lambda now, total, **_: seen.append((now, total))
    from concurrent.futures import ThreadPoolExecutor

    with ThreadPoolExecutor(1) as executor:
        options = AvatarStudyOptions(frames=8)
        list(study(tmp_path, AMIRA[:1], [FULL], body, options, (), progress, executor))
    assert seen[-1][0] == seen[-1][1] == 8 * studies.ROUGHLY + 3000
    assert [now for now, _ in seen] == sorted(now for now, _ in seen)


def test_what_a_result_depends_on_is_all_but_case_and_row(body):
    made = AvatarStudyOptions().made_with(body)
    assert set(made) == {"options", "body", "sources"} and json.loads(json.dumps(made)) == made
    assert made != AvatarStudyOptions(size=256).made_with(body)


@pytest.fixture
def refined(subject, tmp_path):
    """The tiny subject, refined to other poses than those of stage 1."""
    folder = tmp_path / "subject"
    shutil.copytree(subject, folder)
    pose, shape = load_poses(folder / "poses.npz")
    pose.rotations[:, 3] += 0.05
    offsets = torch.full((10_000, 3), 0.001)
    save_poses(folder / "poses_refined.npz", pose, shape, stage=2, offsets=offsets)
    return folder


def row_run(name, subject, body, made_with=None):
    (row,) = rows_named((name,))
    out = subject.parent / "run"
    return RowRun(subject, out, row, body, FitOptions(steps=3), made_with or {"sources": "a"})


def test_rows_open_the_poses_that_they_are_named_after(refined, body):
    stage1, better = (load_poses(refined / f)[0] for f in ("poses.npz", "poses_refined.npz"))
    for name, pose in (("full", better), ("without either", stage1), ("GART-like", stage1)):
        video = row_run(name, refined, body).video()
        assert torch.equal(video.pose.rotations, pose.rotations)
    assert row_run("one held-out range", refined, body).video().splits.test == [2]
    assert row_run("full", refined, body).video().splits.test == [3]


def test_a_still_life_turns_and_moves_as_a_whole(refined, body):
    run = row_run("static 3DGS", refined, body)
    video, whole = run.video(), row_run("full", refined, body).video()
    assert torch.equal(video.pose.rotations[:, 0], whole.pose.rotations[:, 0])
    assert (video.pose.rotations[:, 1:] == whole.pose.rotations[0, 1:]).all()
    driven = run.driven(video)(whole.pose)
    assert torch.equal(driven.rotations, video.pose.rotations)
    full = row_run("full", refined, body)
    assert full.driven(whole)(whole.pose) is whole.pose


def test_only_rows_that_know_of_a_displaced_surface_are_seeded_on_it(refined, body):
    count = len(body.v_template)
    pose, shape = load_poses(refined / "poses_refined.npz")
    offsets = torch.full((count, 3), 0.001)
    save_poses(refined / "poses_refined.npz", pose, shape, stage=2, offsets=offsets)
    seeded = {
        row.name
        for row in ROWS
        if row_run(row.name, refined, body).offsets() is not None and not row.of(FitOptions()).naked
    }
    naked = {
        "without refinement", "without either", "GART-like", "seeded on the naked body",
        "without re-initialisation, naked",
    }  # fmt: skip
    assert seeded == {row.name for row in ROWS} - naked


def test_a_run_that_another_program_left_is_made_anew(refined, body):
    run = row_run("full", refined, body)
    run.out.mkdir()
    (run.out / MADE_WITH).write_text('{"sources": "b"}')
    (run.out / "checkpoint.pt").write_text("of another program")
    run._make_room()
    assert [path.name for path in run.out.iterdir()] == [MADE_WITH]
    (run.out / "checkpoint.pt").write_text("its own")
    run._make_room()
    assert (run.out / "checkpoint.pt").exists()


@pytest.mark.slow
def test_a_small_study_runs_and_goes_on(tmp_path, body):
    bare = [case for case in TUNING if case.take.bare][0]
    options = AvatarStudyOptions(
        frames=8, size=64, novel=1, refine=SequenceOptions(size=64, passes=2),
        fit=FitOptions(steps=8, schedule=Schedule(densify_every=4)),
    )  # fmt: skip
    rows = rows_named(("full", "static 3DGS", "one held-out range"))
    found = list(study(tmp_path, [bare], rows, body, options))
    splits = {(s.name, s.split) for s in found[0].scores}
    assert {("full", "test"), ("full", "novel_view")} <= splits
    assert ("after one similarity transform", "novel_pose") in splits
    assert ("poses fitted to the pictures", "test") in splits
    assert [f.moment for f in found[0].surface] == ["before", "after"] * 2 + ["end"]
    assert all(abs(r.similarity["scale"] - 1) < 0.2 for r in found)
    again = list(study(tmp_path, [bare], rows[:1], body, options))
    assert again[0].scores == found[0].scores


def test_nobody_who_judges_is_tuned_on():
    """The study has no list of people of its own."""
    people = [{case.take.person for case in some} for some in (TUNING, HELD_OUT)]
    assert not people[0] & people[1]
    assert not hasattr(studies, "HELD_OUT") and not hasattr(studies, "TUNING")
