"""Folders in which the documented commands run on tiny inputs."""

import contextlib
import io
import runpy
import shlex
import shutil
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest


def module_of(name):
    return SimpleNamespace(**runpy.run_path(str(Path(__file__).with_name(f"{name}.py"))))


def make_bare_subject(out, options, *given):
    """Make a subject quickly: without clothes and hair, with few rays and held-out pictures."""
    from gva_mi.synthetic import make_subject

    bare = {"bare": True, "samples": 1, "novel_poses": 1, "novel_views": 1}
    make_subject(out, replace(options, workers=1, **bare), *given)


@pytest.fixture(scope="session")
def gva():
    """Run a command of the command line in a folder: exit code, standard output and error."""
    from gva_mi.__main__ import main

    def run(folder, *words):
        out, err = io.StringIO(), io.StringIO()
        with pytest.MonkeyPatch.context() as patch, contextlib.chdir(folder):
            patch.setattr("gva_mi.cli.synth.make_subject", make_bare_subject)
            patch.setattr(sys, "argv", ["gva-mi", *map(str, words)])
            with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
                try:
                    main()
                    code = 0
                except SystemExit as stop:
                    code = stop.code
        return code, out.getvalue(), err.getvalue()

    return run


@pytest.fixture(scope="session")
def readers_folder(tmp_path_factory, gva):
    """Run README's commands one after the other in a folder: a subject, a run, its results."""
    pages, less = module_of("pages"), module_of("less")
    folder = tmp_path_factory.mktemp("reader")
    for command in pages.typed(pages.PAGES[0]):
        if command in less.NOT_RUN:
            continue
        code, _, err = gva(folder, *shlex.split(command)[1:], *less.smaller(command))
        assert code == 0, f"{command}: {err}"
    return folder


@pytest.fixture
def reader(readers_folder, known, turning, tmp_path):
    """Return a function that makes a folder with everything a page presupposes."""
    presupposed = module_of("presupposed")

    def prepared(page):
        folder = shutil.copytree(readers_folder, tmp_path / "here")
        presupposed.prepare(page, folder, known, turning)
        return folder

    return prepared
