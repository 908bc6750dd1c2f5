"""Nothing that judges was there to choose by; a variant changes what its name says."""

from collections import Counter
from dataclasses import asdict, replace

import pytest

from gva_mi.core.errors import InputError
from gva_mi.fit import paper
from gva_mi.fit.options import FitOptions
from gva_mi.study.cases import HELD_OUT, LIMITS, NO_NORMALS, TOUCH, TUNING, held_out
from gva_mi.study.variants import (
    ALPHAS_MM,
    BY_ALPHA,
    CHANGES,
    FULL,
    LADDER,
    VARIANTS,
    variants_named,
)
from gva_mi.subject.fingerprint import VIDEO_KIND
from gva_mi.synthetic.errors.models import ERROR_MODELS
from gva_mi.synthetic.person.identity import NAMED

BOTH = pytest.mark.parametrize(
    "some", [TUNING, HELD_OUT, held_out(2)], ids=["tuned", "held out", "set 2"]
)


def test_held_out_sets_share_no_subject_and_no_draw_and_are_alike_in_all_else():
    case_sets = [TUNING, *(held_out(n) for n in (1, 2, 3, 1000))]
    for k, some in enumerate(case_sets):
        for others in case_sets[:k]:
            assert not {c.take.person for c in some} & {c.take.person for c in others}
            assert not {c.draw for c in some} & {c.draw for c in others}
    alike = lambda c: (c.kind_of_errors, c.take.motion, c.take.figure, c.take.outfit, c.take.bare)
    assert held_out() is HELD_OUT
    assert [alike(c) for c in held_out(2)] == [alike(c) for c in HELD_OUT]


@BOTH
def test_cases_are_distinct(some):
    assert len({case.name for case in some}) == len({case.draw for case in some}) == len(some)
    known = {*ERROR_MODELS, VIDEO_KIND}
    assert all(case.take.subject in (None, *NAMED) and case.noise in known for case in some)


def test_limits_change_one_thing_of_one_video_at_a_time():
    usual, *others = (asdict(case.take) for case in LIMITS)
    for other in others:
        assert len([key for key, value in other.items() if value != usual[key]]) == 1
    assert len({case.row for case in LIMITS}) == len(LIMITS)
    assert not {case.take.person for case in LIMITS} & {c.take.person for c in (*TUNING, *HELD_OUT)}
    made = [case.take.synth(48, 512) for case in LIMITS]
    assert {m.frames for m in made} == {30, 48, 120} and {m.camera for m in made} >= {"held"}


def test_held_out_cases_cover_all_error_models_and_some_were_never_tuned_on():
    families = Counter(case.kind_of_errors for case in HELD_OUT)
    assert set(families) == {*ERROR_MODELS, NO_NORMALS, VIDEO_KIND, TOUCH}
    assert set(families) - {case.kind_of_errors for case in TUNING} == {"shape", "focal", "normals"}
    takes = {case.take for case in HELD_OUT}
    assert {take.figure for take in takes} == {"own", "stretched", "anny"}
    assert {take.motion for take in takes} == {"turn", "everyday", "half", "walk", "touch"}
    assert {take.outfit for take in takes} == {"own", "foreign", "dress", "coat"}
    assert any(take.bare for take in takes)
    assert all(case.take.scene == "room" for case in HELD_OUT if case.noise == VIDEO_KIND)


@BOTH
def test_every_take_has_valid_options(some):
    """Its motion, figure and outfit are ones that subjects have; else the options refuse."""
    for case in some:
        options = case.take.synth(8, 64)
        assert options.frames == 8 and options.novel_views == options.novel_poses == 0
        assert options.bare is case.take.bare


def changed(name):
    """The options in which a row differs from full, by their paths."""

    def paths(before, after, path=""):
        for key in before:
            here = f"{path}.{key}".lstrip(".")
            if isinstance(before[key], dict):
                yield from paths(before[key], after[key], here)
            elif before[key] != after[key]:
                yield here

    (variant,) = variants_named((name,))
    return set(paths(asdict(FitOptions()), asdict(variant.of(FitOptions()))))


RANGE = VARIANTS[-1]  # other test frames alone


def test_a_variant_changes_what_its_options_name_and_nothing_else():
    assert changed("with residual") == {"avatar.residual.enabled", "loss.residual"}
    assert changed("GART-like") == {
        "avatar.hands", "avatar.stretch", "naked", "schedule.reinit_at", "loss.perceptual",
        "loss.residual", "loss.alpha", "loss.ssim",
    }  # fmt: skip
    for variant in VARIANTS:  # each is another way to make an avatar
        assert changed(variant.name) or variant.poses != "refined" or variant in (FULL, RANGE)


def test_rows_with_fixed_poses_have_no_first_fit_which_would_train_them():
    for variant in VARIANTS:
        options = variant.of(FitOptions(first_steps=5))
        assert options.first_steps == (5 if options.poses.trained else 0), variant.name


def test_the_ladder_leads_from_the_paper_to_the_whole_method():
    """Its first row is the preset; without its residual, the last one is the default."""
    options = FitOptions(steps=700, seed=3)
    first, last = (LADDER[k].of(options) for k in (0, -1))
    assert first == replace(paper.FIT, steps=700, seed=3) and LADDER[0].poses == "printed"
    assert replace(last, avatar=options.avatar) == options
    assert replace(last.avatar, residual=options.avatar.residual) == options.avatar
    for (name, _), before, after in zip(CHANGES[2:], LADDER[1:-1], LADDER[2:], strict=True):
        assert before.of(options) != after.of(options), name
    assert variants_named(("full", "ladder")) == [*LADDER, FULL]
    assert variants_named(("alphas",)) == list(BY_ALPHA)
    wide = BY_ALPHA[-1].of(options)
    assert wide == replace(first, reinit=replace(first.reinit, alpha=ALPHAS_MM[-1] / 1000))


def test_rows_are_chosen_by_name_and_keep_their_order():
    assert variants_named(()) == list(VARIANTS)
    names = [v.name for v in variants_named(("true poses", "full"))]
    assert names == ["full", "true poses"]
    with pytest.raises(InputError, match="--rows has no 'best'; there are: as printed, "):
        variants_named(("best",))
