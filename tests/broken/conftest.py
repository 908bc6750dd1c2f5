"""Folders and files that somebody broke by hand, and one run that is whole."""

import importlib.util
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from gva_mi.body.pose import save_poses
from gva_mi.fit import run_folder


def _module(name):
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def broken_subjects():
    return _module("subjects").SUBJECTS


@pytest.fixture(scope="session")
def broken_runs():
    return _module("runs").RUNS


@pytest.fixture
def copied(subject, tmp_path):
    """A subject to break."""
    return shutil.copytree(subject, tmp_path / "subject")


@pytest.fixture
def run(known, turning, tmp_path):
    """A finished run to break."""
    folder = tmp_path / "run"
    known.save(folder / "avatar.npz")
    save_poses(folder / "poses.npz", *turning(6), stage=2)
    options = {"options": {"steps": 3, "seed": 0}, "versions": {}, "video": {}}
    (folder / "options.json").write_text(json.dumps(options))
    np.savez(folder / "history.npz", loss=np.arange(3.0), gaussians=np.arange(3))
    state = {"step": 2, "avatar": known.record(), "history": {"loss": [1.0, 2.0]}}
    run_folder.save_state(folder, state)
    return folder


@pytest.fixture
def refused_or_taken(cli):
    """Run a command: None where it took what it was given, else the one sentence of its refusal."""

    def call(*arguments):
        code, _, err = cli(*arguments)
        said = [line for line in err.replace("\r", "\n").split("\n") if "%|" not in line]
        said = [line for line in said if line.startswith("gva-mi: ")]
        assert "Traceback" not in err
        if code != 2:
            assert code in (0, 1) and not said, (code, err)
            return None
        assert len(said) == 1 and said[0].isprintable() and len(said[0]) < 2000, err
        return said[0]

    return call
