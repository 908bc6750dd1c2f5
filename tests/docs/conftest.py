"""Folders in which the commands of the documentation run, on tiny inputs."""

import contextlib
import importlib.util
import io
import shlex
import shutil
import sys
from pathlib import Path

import pytest


def module_of(name, folder=Path(__file__).parent):
    spec = importlib.util.spec_from_file_location(name, folder / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="session")
def gva():
    """Run a command of the command line in a folder: exit code, standard output and error."""
    from gva_mi.__main__ import main

    def run(folder, *words):
        out, err = io.StringIO(), io.StringIO()
        with pytest.MonkeyPatch.context() as patch, contextlib.chdir(folder):
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
    """Where README's commands were run, one after the other: a subject, a run, what came of it."""
    pages, less = module_of("pages"), module_of("less")
    folder = tmp_path_factory.mktemp("reader")
    for command in pages.typed(pages.PAGES[0]):
        code, _, err = gva(folder, *shlex.split(command)[1:], *less.smaller(command))
        assert code == 0, f"{command}: {err}"
    return folder


@pytest.fixture
def reader(readers_folder, known, turning, tmp_path):
    """Makes a folder of one's own in which a page begins, with what the page presupposes."""
    presupposed = module_of("presupposed")

    def prepared(page):
        folder = shutil.copytree(readers_folder, tmp_path / "here")
        presupposed.prepare(page, folder, known, turning)
        return folder

    return prepared
