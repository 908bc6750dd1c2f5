"""Good files of every kind that is read, and the generator of bad ones."""

import importlib.util
from pathlib import Path

import pytest


def _module(name):
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def mutated():
    return _module("mutations").mutated


@pytest.fixture(scope="session")
def seeds(subject, known):
    """For each reader, what writes its good files into a folder: see seeds.py."""
    ours, estimators = _module("seeds").seeds(subject, known), _module("estimators").estimators()
    others = _module("datasets").datasets() | _module("networks").networks()
    return ours | estimators | others
