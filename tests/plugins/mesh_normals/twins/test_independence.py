"""A check is worth what it does not share with what it checks: read from the imports."""

import ast
from pathlib import Path

import pytest

PLUGINS = Path(__file__).parents[4] / "plugins"
PACKAGE = "gva_mi_plugins.mesh_normals"
TWINS = ["moving_mesh", "measured_sensor", "differences", "scanlines"]
# What the third way may share: numberings, the sensor's axes, what a shading normal is.
SHARED = {f"{PACKAGE}.{name}" for name in ("topology", "projection", "surface")}


def imports(path):
    """The modules of this project that a file imports."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0
            found.add(node.module)
    return {name for name in found if name.startswith("gva_mi")}


def files(folder):
    return sorted(path for path in (PLUGINS / folder).glob("*.py"))


def test_every_file_is_known():
    names = {path.stem for path in files("mesh_normals/twins")}
    assert names == {"__init__", "projective", *TWINS}


@pytest.mark.parametrize("name", TWINS)
def test_a_twin_imports_twins_alone(name):
    allowed = {f"{PACKAGE}.twins.{other}" for other in TWINS}
    assert imports(PLUGINS / f"mesh_normals/twins/{name}.py") <= allowed


def test_the_projective_integrator_shares_no_motion():
    assert imports(PLUGINS / "mesh_normals/twins/projective.py") <= SHARED


@pytest.mark.parametrize("path", files("mesh_normals"), ids=lambda path: path.stem)
def test_the_integrator_knows_no_twin(path):
    assert not any(name.startswith(f"{PACKAGE}.twins") for name in imports(path))
