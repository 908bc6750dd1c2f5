"""A study computes what is missing, keeps what still holds, and is resumed."""

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
import pytest

from gva_mi.core.errors import InputError
from gva_mi.core.files import write_json
from gva_mi.core.stamp import RESULTS_VERSIONS
from gva_mi.data.fingerprint import FILM
from gva_mi.data.ground_truth import load_ground_truth
from gva_mi.data.video import load_video
from gva_mi.pose import SequenceOptions
from gva_mi.pose.stature import Stature
from gva_mi.study.avatar_study import AvatarStudy, AvatarStudyOptions
from gva_mi.study.cases import TUNING
from gva_mi.study.engine import Outcome, Study, run_study
from gva_mi.study.refine_study import RefineStudy, RefineStudyOptions, height_of, with_true_focal
from gva_mi.study.subjects import Filming, filming_work
from gva_mi.study.variants import FULL

MADE = {"options": {"frames": 8}, "results_version": 1}


@dataclass(frozen=True)
class Counted:
    """A piece of work that says what was done."""

    what: object
    steps: int = 3

    def solve(self, progress=None):
        DONE.append(self.what)
        return {"psnr: test": float(len(DONE))}


DONE = []


class Counting(Study):
    """A study of two rounds."""

    kind, variants, made_with, stamp = "avatar", ("a", "b"), MADE, "made"

    def rounds(self, missing):
        return [[Counted(case) for case, _ in missing[:1]], [Counted(pair) for pair in missing]]


COUNTING = Counting(None, None, None)


def test_only_what_is_missing_is_computed_in_the_order_of_the_cases():
    DONE.clear()
    known = [Outcome(TUNING[0], "b", {"psnr: test": 5.0})]
    found = list(run_study(COUNTING, TUNING[:2], known))
    assert [o.key for o in found] == [(case, v) for case in TUNING[:2] for v in "ab"]
    missing = [(TUNING[0], "a"), (TUNING[1], "a"), (TUNING[1], "b")]
    assert found[1] is known[0] and DONE == [TUNING[0], *missing]
    DONE.clear()
    assert list(run_study(COUNTING, TUNING[:2], found)) == found and not DONE


def test_progress_counts_up_to_all_of_the_work():
    seen = []
    progress = lambda now, total, **_: seen.append((now, total))
    with ThreadPoolExecutor(1) as executor:
        list(run_study(COUNTING, TUNING[:1], (), progress, executor))
    assert seen[-1] == (9, 9) and seen == sorted(seen)


def test_results_hold_for_the_same_options_body_and_version_alone(tmp_path, body, monkeypatch):
    study = RefineStudy(tmp_path, body, RefineStudyOptions())
    made, options = study.stamp, study.options
    fewer = body.on(range(0, len(body.v_template), 2), body.faces[:0])
    for other in (
        RefineStudy(tmp_path, body, replace(options, frames=32)),
        RefineStudy(tmp_path, body, replace(options, refine=SequenceOptions(passes=7))),
        RefineStudy(tmp_path, fewer, options),
        AvatarStudy(tmp_path, body, AvatarStudyOptions(), [FULL]),
    ):
        assert other.stamp != made
    monkeypatch.setitem(RESULTS_VERSIONS, "refine", RESULTS_VERSIONS["refine"] + 1)
    assert RefineStudy(tmp_path, body, options).stamp != made


def test_what_the_refinements_version_changes_is_made_again(tmp_path, body, monkeypatch):
    """Avatars begin with refined poses; masks and poses of a film are results, too."""
    film = next(case for case in TUNING if case.noise == FILM)
    other = next(case for case in TUNING if case.noise != FILM)

    def made():
        avatars, filming = (
            AvatarStudy(tmp_path, body, AvatarStudyOptions(), [FULL]),
            Filming(tmp_path, 8, 64),
        )
        return avatars.stamp, filming.subject(film), filming.subject(other)

    before = made()
    monkeypatch.setitem(RESULTS_VERSIONS, "refine", RESULTS_VERSIONS["refine"] + 1)
    assert [one == two for one, two in zip(before, made(), strict=True)] == [False, False, True]


def test_the_file_keeps_results_as_long_as_they_hold(tmp_path):
    study = Counting(tmp_path, None, None)
    assert study.load() == []
    outcomes = [Outcome(case, "full", {"psnr: test": 30.0, "lpips: test": None}) for case in TUNING]
    study.save(outcomes, {"tuned": {}})
    assert study.load() == outcomes
    record = json.loads(study.path.read_text())
    assert record["results"][0]["held_out"] is False and record["summary"] == {"tuned": {}}
    write_json(study.path, record | {"stamp": "another"})
    assert study.load() == []


@pytest.mark.parametrize(
    "text, match",
    [("{", "not readable"), ("[]", "of another form"), ('{"cases": []}', "another version")],
)
def test_a_file_that_cannot_be_used_is_named(tmp_path, text, match):
    (tmp_path / "avatar.json").write_text(text)
    with pytest.raises(InputError, match=rf"avatar.json: .*{match}.*--overwrite"):
        Counting(tmp_path, None, None).load()


def test_a_take_is_filmed_by_one_worker(tmp_path, body):
    amira = [case for case in TUNING if case.take.person == "amira"]
    filming = Filming(tmp_path, 8, 64)
    films = [work.call.args[0] for work in filming_work(filming, [*amira, TUNING[1]], body)]
    assert films == [tuple(amira), (TUNING[1],)]
    folders = {filming.subject(case) for cases in films for case in cases}
    assert len(folders) == len(amira) + 1


@pytest.mark.slow
def test_a_small_study_runs_and_keeps_its_subjects(tmp_path, body):
    options = RefineStudyOptions(frames=3, size=48, refine=SequenceOptions(size=48, passes=2))
    study = RefineStudy(tmp_path, body, options)
    bare = next(case for case in TUNING if case.take.bare)
    two = [bare, replace(bare, noise="white", draw=50, normals=False)]
    first, second = run_study(study, two)
    assert first.figures["points"] == "vertices" and first.figures["finger_mm_stage1"] > 0
    assert first.figures["vertex_mm_stage1"] != second.figures["vertex_mm_stage1"]
    assert [len(list((tmp_path / name).iterdir())) for name in ("takes", "videos")] == [1, 2]
    (again,) = run_study(study, two[:1])
    timed = {"time: s a frame": 0, "seconds_per_frame": 0}
    assert {**again.figures, **timed} == {**first.figures, **timed}


@pytest.mark.slow
def test_a_foreign_body_is_measured_by_joints(tmp_path, body):
    options = RefineStudyOptions(frames=2, size=48, refine=SequenceOptions(size=48, passes=1))
    stretched = next(case for case in TUNING if case.take.figure == "stretched")
    (found,) = run_study(RefineStudy(tmp_path, body, options), [stretched])
    assert found.figures["points"] == "joints"
    assert found.figures["vertex_mm_stage1"] > 0


@pytest.mark.slow
def test_known_height_and_focal_length_fix_the_depth(tmp_path, body):
    refine = SequenceOptions(size=48, passes=1)
    options = RefineStudyOptions(frames=3, size=48, refine=refine, known=True)
    bare = next(case for case in TUNING if case.take.bare)
    case = replace(bare, noise="focal", draw=51)
    filming = Filming(tmp_path, 3, 48)
    filming.film([case], body)
    video = load_video(filming.subject(case))
    truth = load_ground_truth(video.truth, body)
    zoomed = with_true_focal(truth, video, body)
    focal, right = (v.cameras[0].fx / truth.cameras[0].fx for v in (video, zoomed))
    assert abs(focal - 1) > 0.03 and right == pytest.approx(1)
    pelvis = [v.pose.transl + body.rest(v.shape).joints[0] for v in (video, zoomed)]
    seen = [v.cameras[0].project(p.numpy()) for v, p in zip((video, zoomed), pelvis, strict=True)]
    np.testing.assert_allclose(seen[1], seen[0], atol=1e-3)
    assert height_of(truth) == pytest.approx(float(Stature.of(body).height(truth.shape)), abs=0.01)
    (found,) = run_study(RefineStudy(tmp_path, body, options), [case])
    figures = found.figures
    assert abs(figures["pelvis_depth_mm"]) < 0.5 * abs(figures["pelvis_depth_mm_stage1"])
