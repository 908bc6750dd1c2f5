"""A working libLLVM is found before Dr.Jit is imported; a bad one never aborts the process."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from gva_mi.core import llvm

BAD = [library.path for library in llvm.installed() if library.major < llvm.OLDEST]
needs_bad_llvm = pytest.mark.skipif(not BAD, reason="this machine has no libLLVM that is too old")


def run(code: str, **environment: str) -> subprocess.CompletedProcess:
    clean = {k: v for k, v in os.environ.items() if k not in (llvm.PATH, llvm._CHECKED)}
    return subprocess.run(
        [sys.executable, "-c", code], env=clean | environment, capture_output=True, text=True
    )


def test_a_kernel_runs_whatever_is_imported_first():
    kernel = "import drjit as dr, drjit.llvm as l; print(dr.minimum(l.Float(3), l.Float(2))[0])"
    for first in ("gva_mi.splat", "gva_mi_plugins"):
        result = run(f"import {first}; {kernel}")
        assert result.stdout.strip() == "2.0", f"{first}: {result.stderr}"


def test_children_inherit_the_choice_without_a_second_trial():
    code = f"import gva_mi, os; print(os.environ['{llvm.PATH}'] == os.environ['{llvm._CHECKED}'])"
    assert run(code).stdout.strip() == "True"


def test_a_path_that_does_not_exist_is_refused_with_a_reason():
    result = run("import gva_mi.splat", DRJIT_LIBLLVM_PATH="/nowhere/libLLVM.so")
    assert result.returncode == 1
    assert "no such file" in result.stderr


@needs_bad_llvm
def test_a_library_that_aborts_is_refused_before_a_kernel_runs():
    result = run("import gva_mi.splat", DRJIT_LIBLLVM_PATH=str(BAD[-1]))
    assert result.returncode == 1  # not SIGABRT
    assert "cannot be used" in result.stderr and "Unset it" in result.stderr


@needs_bad_llvm
def test_drjit_imported_first_with_a_bad_library_is_explained():
    result = run("import drjit, gva_mi", DRJIT_LIBLLVM_PATH=str(BAD[-1]))
    assert result.returncode == 1
    assert "Import gva_mi first" in result.stderr


def test_a_machine_without_a_usable_library_names_the_package(monkeypatch):
    monkeypatch.setattr(llvm, "installed", lambda: iter([llvm.Library(Path("libLLVM-15.so"), 15)]))
    with pytest.raises(ImportError, match=f"has: 15 .*apt-get install {llvm.PACKAGE}"):
        llvm.find()
