"""Examples in docstrings run, and print what they say; every public name has one."""

import ast
import doctest
import importlib
import pkgutil
from pathlib import Path

import pytest

from gva_mi.mesh.mesh_scene import load_plugins

PACKAGES = ("gva_mi.splat", "gva_mi.body", "gva_mi.mesh", "gva_mi.avatar", "gva_mi.app",
    "gva_mi.gradcheck", "gva_mi_plugins")  # fmt: skip


def public_names(source):
    """Return the public functions and classes of a module."""
    kinds = (ast.FunctionDef, ast.ClassDef)
    names = {node.name for node in ast.parse(source).body if isinstance(node, kinds)}
    return {name for name in names if not name.startswith("_")}


def modules():
    """Yield the names of the modules, and of what needs an example there.

    The functions of gva_mi.splat.kernels do not: they are lines of equations.
    """
    for package in PACKAGES:
        path = importlib.import_module(package).__path__
        inside = (found.name for found in pkgutil.walk_packages(path, f"{package}."))
        for name in (package, *inside):
            source = Path(importlib.util.find_spec(name).origin).read_text()
            names = set() if ".kernels." in name else public_names(source)
            if names or ">>>" in source:
                yield pytest.param(name, names, id=name)


@pytest.mark.parametrize(("name", "public"), list(modules()))
def test_every_public_name_has_an_example_that_prints_what_it_says(name, public):
    if name.startswith("gva_mi_plugins."):
        load_plugins()  # their classes derive from Mitsuba's, which a variant brings
    module = importlib.import_module(name)
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    found = [test for test in doctest.DocTestFinder().find(module) if test.examples]
    for test in found:
        runner.run(test)
    assert found and not runner.failures
    assert not public - {test.name.removeprefix(f"{name}.").partition(".")[0] for test in found}
