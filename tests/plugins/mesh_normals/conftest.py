"""What the plugin is checked with: the references of the gradient check, and differences."""

import importlib.util
from pathlib import Path
from types import SimpleNamespace

import pytest


@pytest.fixture(scope="session")
def references(scenes):
    """References of the derivative, through a Mitsuba sensor; loaded once it has its variant."""
    from gva_mi.gradcheck import interior, moving_mesh, scanlines

    path = Path(__file__).with_name("differences.py")
    spec = importlib.util.spec_from_file_location("differences", path)
    differences = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(differences)
    return SimpleNamespace(
        MovingMesh=moving_mesh.MovingMesh,
        lens=differences.MeasuredLens.of,
        total=differences.total,
        interior=interior.interior,
        boundary=scanlines.boundary,
        upper_envelope=scanlines.upper_envelope,
    )
