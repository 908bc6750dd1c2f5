"""What several folders of tests share."""

import os
import sys

import pytest

import gva_mi  # noqa: F401  chooses the libLLVM before a test imports Dr.Jit

# As the command line does: torch's idle threads leave the cores to Dr.Jit's.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


@pytest.fixture
def cli(capsys, monkeypatch):
    """Run ``gva-mi`` in this process; returns exit code, standard output and standard error."""
    from gva_mi.__main__ import main

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["gva-mi", *map(str, arguments)])
        try:
            main()
            code = 0
        except SystemExit as stop:
            code = stop.code
        captured = capsys.readouterr()
        return code, captured.out, captured.err

    return run
