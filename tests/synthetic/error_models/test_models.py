"""Error models draw their parameters from the seed."""

from dataclasses import asdict

import pytest

from gva_mi.synthetic.error_models.models import ERROR_MODELS, ErrorParameters, draw_errors

SEEDS = range(8)
DRAWN = {  # parameters that only the error model of this name draws, and anything
    "lean": {"pose.lean.legs", "pose.lean.trunk", "pose.lean.arms"},
    "shape": {"pose.depth_follows"},
    "outliers": {f"pose.outliers.{name}" for name in ("swapped", "whole", "jumps", "jump")},
    "focal": {"pose.focal"},
    "masks": {"mask.grown", "mask.lost_feet", "mask.bag"},
    "normals": {"normal.flat", "normal.turn", "normal.convention", "normal.missing"},
}
FIXED = {"pose.depth_follows", "pose.white"}  # by the models that have them


def flat(value, name=""):
    if not isinstance(value, dict):
        return {name[1:]: value}
    return {k: v for key, part in value.items() for k, v in flat(part, f"{name}.{key}").items()}


def parameters(error_model):
    drawn = [flat(asdict(draw_errors(error_model, seed))) for seed in SEEDS]
    return {name: [one[name] for one in drawn] for name in drawn[0]}


@pytest.mark.parametrize("error_model", sorted(ERROR_MODELS.keys() - {"bursts", "anything"}))
def test_another_seed_draws_other_parameters_and_those_of_other_models_stay(error_model):
    usual = flat(asdict(ErrorParameters()))
    of_others = set().union(*(names for model, names in DRAWN.items() if model != error_model))
    for name, values in parameters(error_model).items():
        if name in of_others:
            assert set(values) == {usual[name]}, name
        elif name not in FIXED:
            assert len(set(values)) > 1, name


def test_error_models_draw_in_their_ranges():
    assert set(parameters("white")["pose.white"]) == {1.0}
    assert set(parameters("shape")["pose.depth_follows"]) == {True}
    assert all(15 <= m <= 20 for m in parameters("slow")["pose.memory"])
    assert all(0.034 < a < 0.105 for a in parameters("lean")["pose.lean.legs"])  # rad
    assert all(0.04 <= abs(f) <= 0.1 for f in parameters("focal")["pose.focal"])
    assert set(parameters("normals")["normal.convention"]) == {"perspective", "icon"}
