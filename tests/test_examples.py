"""Examples in docstrings run, and print what they say."""

import doctest
import importlib
import pkgutil

import pytest

from gva_mi.mesh.mesh_scene import load_plugins

PACKAGES = (
    "gva_mi.splat", "gva_mi.body", "gva_mi.mesh", "gva_mi.avatar", "gva_mi.app",
    "gva_mi.gradcheck", "gva_mi_plugins",
)  # fmt: skip


def modules(package):
    """Name a package and all modules below it, without importing those."""
    yield package
    path = importlib.import_module(package).__path__
    yield from (found.name for found in pkgutil.walk_packages(path, f"{package}."))


def examples():
    """Yield each docstring with examples, by the module's source: nothing is run."""
    parser = doctest.DocTestParser()
    for package in PACKAGES:
        for name in modules(package):
            source = importlib.util.find_spec(name).origin
            if ">>>" in open(source).read():
                yield name, parser


@pytest.mark.parametrize("name", sorted({name for name, _ in examples()}))
def test_examples_print_what_they_say(name):
    if name.startswith("gva_mi_plugins."):
        load_plugins()  # their classes derive from Mitsuba's, which a variant brings
    module = importlib.import_module(name)
    flags = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS
    failed, tried = doctest.testmod(module, optionflags=flags)
    assert tried and not failed
