"""Motions broken by hand: each is read as finite poses, or refused in one sentence."""

import importlib.util
from pathlib import Path

import pytest
import torch

from gva_mi.core.errors import InputError
from gva_mi.data.importers.motions import MotionOptions, read_motion
from gva_mi.data.importers.target import TargetBody

spec = importlib.util.spec_from_file_location("motions", Path(__file__).with_name("motions.py"))
motions = importlib.util.module_from_spec(spec)
spec.loader.exec_module(motions)

TAKEN = motions.TAKEN
OF_ESTIMATORS = ("gvhmr", "wham", "phalp", "pymafx")  # whose files say no rate


@pytest.fixture(scope="module")
def driven():
    return TargetBody.read(None)


def options(name):
    return MotionOptions(up="y", source_fps=25 if name.startswith(OF_ESTIMATORS) else None)


@pytest.mark.parametrize("form", motions.FORMS)
def test_a_whole_one_is_read(form, tmp_path, driven):
    whole, arrays = motions.FORMS[form]
    path = tmp_path / "motion.pkl"
    path.write_bytes(motions.pickle.dumps(whole(arrays)))
    assert len(read_motion(path, driven, options(form)).pose) >= 1


@pytest.mark.parametrize("name", motions.MOTIONS)
def test_a_broken_one_is_read_or_refused_in_one_sentence(name, tmp_path, driven):
    path = motions.MOTIONS[name](tmp_path)
    try:
        found = read_motion(path, driven, options(name))
    except InputError as error:
        assert str(path) in str(error) and name not in TAKEN, error
        return
    assert all(torch.isfinite(x).all() for x in (found.pose.rotations, found.pose.transl))
    assert torch.isfinite(found.shape.betas).all()
    assert name in TAKEN


def test_what_is_taken_is_of_the_table():
    assert set(motions.MOTIONS) >= TAKEN
