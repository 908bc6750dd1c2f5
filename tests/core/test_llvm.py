"""A working libLLVM is found before Dr.Jit is imported; a bad one never aborts the process."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from gva_mi.core import llvm

BAD = [x for x in llvm.installed() if (llvm.major_of(x) or llvm.OLDEST) < llvm.OLDEST]
needs_bad_llvm = pytest.mark.skipif(not BAD, reason="this machine has no libLLVM that is too old")


def run(code: str, **environment: str) -> subprocess.CompletedProcess:
    clean = {k: v for k, v in os.environ.items() if k != llvm.PATH}
    return subprocess.run(
        [sys.executable, "-c", code], env=clean | environment, capture_output=True, text=True
    )


def test_a_kernel_runs_whatever_is_imported_first():
    kernel = "import drjit as dr, drjit.llvm as l; print(dr.minimum(l.Float(3), l.Float(2))[0])"
    for first in ("gva_mi.splat", "gva_mi_plugins"):
        result = run(f"import {first}; {kernel}")
        assert result.stdout.strip() == "2.0", f"{first}: {result.stderr}"


@pytest.mark.parametrize("name, reason", [
    ("libLLVM.so", "there is no such file"), ("libLLVM-15.so.1", "it is libLLVM 15"),
    ("linked.so", "it is libLLVM 16"), ("renamed.so", "it is libLLVM 14"),
])  # fmt: skip
def test_a_library_that_would_abort_is_refused_before_a_kernel_runs(name, reason, tmp_path):
    for there in ("libLLVM-15.so.1", "libLLVM.so.16.0"):
        (tmp_path / there).touch()
    (tmp_path / "linked.so").symlink_to(tmp_path / "libLLVM.so.16.0")
    (tmp_path / "renamed.so").write_bytes(b"\x7fELF ... \0libLLVM-14.so.1\0 ...")
    result = run("import gva_mi.splat", DRJIT_LIBLLVM_PATH=str(tmp_path / name))
    assert result.returncode == 1  # not SIGABRT
    assert f"cannot be used: {reason}" in result.stderr and "Unset it" in result.stderr


def test_the_version_is_read_where_the_name_is_silent(tmp_path):
    chosen = llvm.find()
    (tmp_path / "any.so").symlink_to(chosen)
    (tmp_path / "libLLVM.so.1").symlink_to(chosen)
    for name in ("any.so", "libLLVM.so.1"):
        assert llvm.major_of(tmp_path / name) == llvm.major_of(chosen)
    assert llvm._major_inside(chosen) == llvm.major_of(chosen)


@needs_bad_llvm
def test_drjit_imported_first_with_a_bad_library_is_explained():
    result = run("import drjit, gva_mi", DRJIT_LIBLLVM_PATH=str(BAD[-1]))
    assert result.returncode == 1
    assert "Import gva_mi first" in result.stderr


def test_a_machine_without_a_usable_library_names_the_package(monkeypatch):
    monkeypatch.setattr(llvm, "installed", lambda: [Path("libLLVM-15.so")])
    with pytest.raises(ImportError, match=f"has: 15 .*apt-get install {llvm.PACKAGE}"):
        llvm.find()
