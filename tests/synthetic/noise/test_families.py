"""Error models draw their parameters from the seed."""

from dataclasses import asdict

import pytest

from gva_mi import InputError
from gva_mi.synthetic import SynthOptions
from gva_mi.synthetic.error_models.masks import MaskErrors
from gva_mi.synthetic.error_models.models import ErrorParameters, Levels, draw_errors
from gva_mi.synthetic.error_models.normals import NormalErrors
from gva_mi.synthetic.error_models.poses import PoseErrors

SEEDS = range(8)
# Parameters that an error model fixes.
SETTLED = {
    "mixed": set(),
    "white": {"pose.white"},
    "slow": set(),
    "lean": set(),
    "shape": {"pose.depth_follows"},
    "outliers": set(),
    "focal": set(),
    "masks": set(),
    "normals": set(),
}
DRAWN = {  # parameters that only the error model of this name draws
    "lean": {"pose.lean.legs", "pose.lean.trunk", "pose.lean.arms"},
    "shape": {"pose.depth_follows"},
    "outliers": {f"pose.outliers.{name}" for name in ("swapped", "whole", "jumps", "jump")},
    "focal": {"pose.focal"},
    "masks": {"mask.grown", "mask.lost_feet", "mask.bag"},
    "normals": {"normal.flat", "normal.turn", "normal.convention", "normal.missing"},
}


def flat(value, name=""):
    if not isinstance(value, dict):
        return {name[1:]: value}
    return {k: v for key, part in value.items() for k, v in flat(part, f"{name}.{key}").items()}


def parameters(family):
    drawn = [flat(asdict(draw_errors(family, seed))) for seed in SEEDS]
    return {name: [one[name] for one in drawn] for name in drawn[0]}


def test_bursts_are_always_the_same():
    assert all(draw_errors("bursts", seed) == ErrorParameters() for seed in SEEDS)
    assert ErrorParameters() == ErrorParameters(PoseErrors(), MaskErrors(), NormalErrors())
    assert (PoseErrors().memory, PoseErrors().white, PoseErrors().outliers.lost) == (5.0, 0.0, 0.08)


@pytest.mark.parametrize("family", SETTLED)
def test_another_seed_draws_other_parameters(family):
    settled = SETTLED[family].union(*(d for name, d in DRAWN.items() if name != family))
    for name, values in parameters(family).items():
        if name in settled:
            assert len(set(values)) == 1, name
        elif name in ("mask.notches", "normal.convention"):  # few values
            assert len(set(values)) > 1, name
        else:
            assert len(set(values)) == len(SEEDS), name


def test_error_models_draw_in_their_ranges():
    assert set(parameters("white")["pose.white"]) == {1.0}
    assert all(15 <= m <= 20 for m in parameters("slow")["pose.memory"])
    assert all(0.034 < a < 0.105 for a in parameters("lean")["pose.lean.legs"])  # rad
    assert all(0.04 <= abs(f) <= 0.1 for f in parameters("focal")["pose.focal"])
    assert set(parameters("normals")["normal.convention"]) == {"perspective", "icon"}


def test_an_unknown_error_model_is_refused():
    with pytest.raises(InputError, match="no family 'brown' of noise; there are: bursts, white"):
        SynthOptions(family="brown")
    with pytest.raises(InputError, match="noise_seed must be from 0 to .*, got -1"):
        SynthOptions(noise_seed=-1)


def test_levels_multiply():
    assert SynthOptions(noise=0.5, mask_noise=3.0).levels == Levels(0.5, 1.5, 0.5)
