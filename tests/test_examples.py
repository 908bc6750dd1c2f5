"""Examples in docstrings run, and print what they say."""

import doctest
import importlib
import inspect
import pkgutil
from pathlib import Path

import pytest

from gva_mi.mesh.mesh_scene import load_plugins

PACKAGES = (
    "gva_mi.splat", "gva_mi.body", "gva_mi.mesh", "gva_mi.avatar", "gva_mi.app",
    "gva_mi.gradcheck", "gva_mi_plugins",
)  # fmt: skip


def modules_with_examples():
    """Name the modules whose source holds an example; none but the packages is imported."""
    for package in PACKAGES:
        path = importlib.import_module(package).__path__
        inside = (found.name for found in pkgutil.walk_packages(path, f"{package}."))
        for name in (package, *inside):
            if ">>>" in Path(importlib.util.find_spec(name).origin).read_text():
                yield name


@pytest.mark.parametrize("name", sorted(modules_with_examples()))
def test_examples_print_what_they_say(name):
    if name.startswith("gva_mi_plugins."):
        load_plugins()  # their classes derive from Mitsuba's, which a variant brings
    module = importlib.import_module(name)
    flags = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS
    failed, tried = doctest.testmod(module, optionflags=flags)
    assert tried and not failed


@pytest.mark.parametrize("package", ["gva_mi.splat", "gva_mi.splat.gsplat", "gva_mi.gradcheck"])
def test_every_name_that_a_package_exports_has_an_example(package):
    exported = vars(importlib.import_module(package))["__all__"]
    public = [getattr(importlib.import_module(package), name) for name in exported]
    silent = [
        item.__name__
        for item in public
        if (inspect.isclass(item) or inspect.isfunction(item))
        and ">>>" not in "".join(doc.docstring for doc in doctest.DocTestFinder().find(item))
    ]
    assert not silent
