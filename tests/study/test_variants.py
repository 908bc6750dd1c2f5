"""Each row changes what its name says, and nothing else."""

from dataclasses import asdict, replace

import pytest

from gva_mi.core.errors import InputError
from gva_mi.fit import paper
from gva_mi.fit.options import FitOptions
from gva_mi.study.variants import CHANGES, FULL, LADDER, VARIANTS, variants_named


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


def test_rows_are_chosen_by_name_and_keep_their_order():
    assert variants_named(()) == list(VARIANTS)
    names = [v.name for v in variants_named(("true poses", "full"))]
    assert names == ["full", "true poses"]
    with pytest.raises(InputError, match="--rows has no 'best'; there are: as printed, "):
        variants_named(("best",))
