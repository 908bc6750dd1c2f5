"""A study computes what is missing, keeps what still holds, and is resumed.

A variant is fitted with what its name says; a run that no longer holds is not used.
"""

import json
import shutil
from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch

from gva_mi.avatar.avatar import AVATAR_SPLATTING, AvatarOptions
from gva_mi.avatar.canonical import SeedOptions
from gva_mi.body.pose import load_poses, save_poses
from gva_mi.core.errors import InputError
from gva_mi.core.files import write_json
from gva_mi.core.srgb import encoded
from gva_mi.core.stamp import RESULTS_VERSIONS
from gva_mi.evaluate import measure
from gva_mi.evaluate.figures import Figure, where
from gva_mi.evaluate.measure import ALIGNED, AS_REFINED, Metrics
from gva_mi.fit.options import FitOptions, Schedule
from gva_mi.fit.photometric import FITTED, PhotometricOptions
from gva_mi.fit.renders import render_frame, render_layer
from gva_mi.fit.run_folder import load_avatar, under_trained_poses
from gva_mi.prior.body_height import Stature
from gva_mi.refine import SequenceOptions
from gva_mi.splat import render
from gva_mi.study import relight
from gva_mi.study.avatar_study import MADE_WITH, AvatarStudy, AvatarStudyOptions, VariantRun
from gva_mi.study.cases import TUNING
from gva_mi.study.engine import Outcome, Study, run_study
from gva_mi.study.refine_study import RefineStudy, RefineStudyOptions, with_true_focal
from gva_mi.study.variants import FULL, NO_HANDS, variants_named
from gva_mi.study.videos import StudyVideos, VideoOptions, height_of
from gva_mi.subject.cameras import save_cameras
from gva_mi.subject.fingerprint import VIDEO_KIND
from gva_mi.subject.ground_truth import load_ground_truth
from gva_mi.subject.pictures import write_image
from gva_mi.subject.video import load_video
from gva_mi.synthetic.pictures.render import Rendering

MADE = {"options": {"frames": 8}, "results_version": 1}


@dataclass(frozen=True)
class Counted:
    """A piece of work that says what was done."""

    what: object
    steps: int = 3

    def solve(self, progress=None):
        DONE.append(self.what)
        return [Figure(split="test", metric="PSNR, dB", value=float(len(DONE)))]


DONE = []


class Counting(Study):
    """A study of two rounds."""

    kind, variants, made_with, stamp = "avatar", ("a", "b"), MADE, "made"

    def rounds(self, missing):
        return [[Counted(case) for case, _ in missing[:1]], [Counted(pair) for pair in missing]]


COUNTING = Counting(None, None, None)


def test_only_what_is_missing_is_computed_in_the_order_of_the_cases():
    DONE.clear()
    known = [Outcome(TUNING[0], "b", ())]
    found = list(run_study(COUNTING, TUNING[:2], known))
    assert [o.key for o in found] == [(case, v) for case in TUNING[:2] for v in "ab"]
    missing = [(TUNING[0], "a"), (TUNING[1], "a"), (TUNING[1], "b")]
    assert found[1] is known[0] and DONE == [TUNING[0], *missing]
    DONE.clear()
    assert list(run_study(COUNTING, TUNING[:2], found)) == found and not DONE


def test_results_hold_for_the_same_options_body_and_version_alone(tmp_path, body, monkeypatch):
    study = RefineStudy(tmp_path, body, RefineStudyOptions())
    made, options = study.stamp, study.options
    fewer = body.on(range(0, len(body.v_template), 2), body.faces[:0])
    for other in (
        RefineStudy(tmp_path, body, replace(options, frames=32)),
        RefineStudy(tmp_path, body, replace(options, refine=SequenceOptions(passes=7))),
        RefineStudy(tmp_path, fewer, options),
        AvatarStudy(tmp_path, body, AvatarStudyOptions(), [FULL]),
        relight.RelightStudy(tmp_path, body, relight.RelightStudyOptions()),
    ):
        assert other.stamp != made
    # Avatars begin with refined poses, and masks and poses of a video are results, too.
    avatars = lambda: AvatarStudy(tmp_path, body, AvatarStudyOptions(), [FULL]).stamp
    videos = StudyVideos(tmp_path, VideoOptions())
    recordings = lambda: [videos.subject(case) for case in TUNING]
    before, filmed = avatars(), recordings()
    monkeypatch.setitem(RESULTS_VERSIONS, "refine", RESULTS_VERSIONS["refine"] + 1)
    assert RefineStudy(tmp_path, body, options).stamp != made and avatars() != before
    assert recordings() == filmed
    monkeypatch.setitem(RESULTS_VERSIONS, "video", RESULTS_VERSIONS["video"] + 1)
    changed = [one != two for one, two in zip(filmed, recordings(), strict=True)]
    assert changed == [case.noise == VIDEO_KIND for case in TUNING]


def test_the_file_keeps_results_as_long_as_they_hold(tmp_path, monkeypatch):
    study = Counting(tmp_path, None, None)
    assert study.load() == []
    outcomes = [
        Outcome(case, "full", (Figure(subject=case.name, variant="full", metric="LPIPS", value=x),))
        for case, x in zip(TUNING, (0.5, *[None] * len(TUNING)), strict=False)
    ]
    study.save(outcomes)
    assert study.load() == outcomes
    record = json.loads(study.path.read_text())
    assert len(record["figures"]) == len(record["cases"]) == len(TUNING)
    monkeypatch.setitem(RESULTS_VERSIONS, "video", RESULTS_VERSIONS["video"] + 1)
    assert study.load() == [one for one in outcomes if one.case.noise != VIDEO_KIND]
    write_json(study.path, record | {"stamp": "another"})
    assert study.load() == []


@pytest.mark.parametrize(
    "text, match",
    [("{", "not readable"), ("[]", "unexpected format"), ('{"cases": []}', "unexpected format")],
)
def test_a_file_that_cannot_be_used_is_named(tmp_path, text, match):
    (tmp_path / "avatar.json").write_text(text)
    with pytest.raises(InputError, match=rf"avatar.json: .*{match}.*--overwrite"):
        Counting(tmp_path, None, None).load()


@pytest.mark.slow
def test_a_small_study_runs_and_keeps_its_subjects(tmp_path, body):
    options = RefineStudyOptions(frames=3, size=48, refine=SequenceOptions(size=48, passes=2))
    study = RefineStudy(tmp_path, body, options)
    bare = next(case for case in TUNING if case.take.bare)
    two = [bare, replace(bare, noise="white", draw=50, normals=False)]
    first, second = run_study(study, two)
    errors = [where(o.figures, metric="stage 1 error, mm", region="body") for o in (first, second)]
    assert len(errors[0]) == 2 and errors[0][0].value != errors[1][0].value
    assert [len(list((tmp_path / name).iterdir())) for name in ("takes", "videos")] == [1, 2]
    (again,) = run_study(study, two[:1])
    untimed = lambda o: [figure for figure in o.figures if figure.metric != "s a frame"]
    assert untimed(again) == untimed(first)
    twice = replace(study, options=replace(options, repeats=2))
    (both,) = run_study(twice, two[:1])
    (mean,), (one,) = (
        where(o.figures, metric="refined error, mm", region="body", alignment="absolute")
        for o in (both, first)
    )
    assert mean.runs == 2 and 0 < mean.spread < 1 and mean.value == pytest.approx(one.value, abs=1)


@pytest.mark.slow
def test_a_foreign_body_is_measured_by_joints(tmp_path, body):
    options = RefineStudyOptions(frames=2, size=48, refine=SequenceOptions(size=48, passes=1))
    stretched = next(case for case in TUNING if case.take.figure == "stretched")
    (found,) = run_study(RefineStudy(tmp_path, body, options), [stretched])
    assert where(found.figures, metric="stage 1 error, mm", region="joints")[0].value > 0


@pytest.mark.slow
def test_known_height_and_focal_length_fix_the_depth(tmp_path, body):
    refine = SequenceOptions(size=48, passes=1)
    options = RefineStudyOptions(frames=3, size=48, refine=refine, known=True)
    bare = next(case for case in TUNING if case.take.bare)
    case = replace(bare, noise="focal", draw=51)
    videos = StudyVideos(tmp_path, VideoOptions(frames=3, size=48))
    videos.make([case], body)
    video = load_video(videos.subject(case))
    truth = load_ground_truth(video.truth, body)
    zoomed = with_true_focal(truth, video, body)
    focal, right = (v.cameras[0].fx / truth.cameras[0].fx for v in (video, zoomed))
    assert abs(focal - 1) > 0.03 and right == pytest.approx(1)
    pelvis = [v.pose.transl + body.rest(v.shape).joints[0] for v in (video, zoomed)]
    seen = [v.cameras[0].project(p.numpy()) for v, p in zip((video, zoomed), pelvis, strict=True)]
    np.testing.assert_allclose(seen[1], seen[0], atol=1e-3)
    assert height_of(truth) == pytest.approx(float(Stature.of(body).height(truth.shape)), abs=0.01)
    (found,) = run_study(RefineStudy(tmp_path, body, options), [case])
    depth = {f.metric: abs(f.value) for f in where(found.figures, region="pelvis")}
    assert depth["refined depth, mm"] < 0.5 * depth["stage 1 depth, mm"]


OPTIONS = FitOptions(steps=2, window=16, avatar=AvatarOptions(seed=SeedOptions(count=300)),
    schedule=Schedule(reinit_at=()))  # fmt: skip


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
    """A variant, on the tiny subject with novel poses and views of its own."""
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
    few = lambda frames: PhotometricOptions(passes=1)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measure, "_pose_fit_options", few)
        run = VariantRun(case, folder / "run", NO_HANDS, body, OPTIONS, "made")
        yield run, run.solve()


def scores(figures, **about):
    found = where(figures, metric="PSNR, dB", **about)
    return {(f.split, f.alignment, f.region): f.value for f in found}


def test_a_variant_is_fitted_and_measured_in_all_ways(runs):
    run, figures = runs
    found = scores(figures)
    for key in (("test", "", "white"), ("test", AS_REFINED, "white"), ("test", FITTED, "white"),
                ("novel_pose", ALIGNED, "white"), ("novel_view", FITTED, "white"),
                ("test", "", "person")):  # fmt: skip
        assert found[key] is not None, key
    assert where(figures, metric="trained error, mm", region="body")
    assert Metrics.load(run.out).figures == figures
    (count,) = where(figures, metric="Gaussians")
    assert count.value >= 300
    assert load_avatar(run.out).options.hands is False


def test_a_finished_variant_is_not_fitted_again(runs):
    run, figures = runs
    before = (run.out / "avatar.npz").stat().st_mtime_ns
    assert run.solve() == figures
    assert (run.out / "avatar.npz").stat().st_mtime_ns == before


def test_a_cast_of_all_frames_is_no_error_of_relighting(runs, monkeypatch):
    """If the truth is the avatar's own picture, but for a gain, only "not relit" is exact."""
    run, _ = runs
    avatar, video = run.fit()
    video = under_trained_poses(video, run.out)

    def in_other_colors(folder, body, light, frames):
        for k in frames:
            with torch.no_grad():
                g = avatar(video.pose[k])
            colors = encoded(relight.own_colors(avatar, video.pose[k]) * [0.5, 0.7, 0.9])
            g = replace(g, sh=None, colors=torch.from_numpy(colors).float())
            image = render(g, video.cameras[k], AVATAR_SPLATTING, torch.ones(3))
            yield Rendering(image.color.numpy(), image.alpha.numpy(), None, None)

    monkeypatch.setattr(relight, "relit_pictures", lambda *about: list(in_other_colors(*about)))
    figures = relight.relight_figures(run, "left", rays=1)
    found = {f.alignment: f.value for f in where(figures, region="silhouette")}
    assert found["not relit"] > 45
    assert max(found["own light turned"], found["relit"]) < found["not relit"] - 5


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
    assert {("novel_view", "", "white"), ("test", FITTED, "white")} <= scores(figures).keys()
    moments = [figure.split for figure in where(figures, metric="spacing")]
    assert len(moments) == 5 and moments[-1] == "end"
    (again,) = run_study(replace(study, rows=rows[:1]), [bare])
    assert again.figures == figures
