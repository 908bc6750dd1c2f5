"""Find a libLLVM that Dr.Jit can use, before Dr.Jit is imported.

Dr.Jit loads ``libLLVM`` when it is imported and reads ``DRJIT_LIBLLVM_PATH`` only then. LLVM 15 and
16 lack the float ``minimum`` and ``maximum`` that Dr.Jit emits: the first such kernel aborts the
whole process. So ``import gva_mi`` calls :func:`prepare`, which chooses the library.

The version is read from names alone: the file's, its link target's, and the SONAME inside the
library. Nothing is loaded and no kernel is tried, so this takes milliseconds.
"""

from __future__ import annotations

import mmap
import os
import re
import sys
from pathlib import Path

OLDEST = 17  # the first major version whose code generator knows fminimum and fmaximum
# Major versions preferred to others. Chosen: 19, with which the tests run, and its successors.
PREFERRED = range(19, 23)
PACKAGE = "libllvm19"  # Debian 12's and Ubuntu 24.04's name of a version that works

SEARCH_DIRS = (
    "/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib64", "/usr/lib",
    "/usr/local/lib", "/opt/homebrew/opt/llvm/lib", "/usr/local/opt/llvm/lib",
)  # fmt: skip

PATH = "DRJIT_LIBLLVM_PATH"  # an environment variable, which children inherit
# libLLVM-19.so, libLLVM.so.19.1; not libLLVM.so.1, a link that Debian makes
VERSION_IN_NAME = r"libLLVM(?:-|\.so\.)?(\d{2,})"

problem: str | None = None  # why Dr.Jit cannot be used, once prepare() has run


def prepare() -> None:
    """Choose the library, or raise an ImportError if Dr.Jit was imported before with a bad one.

    Without a usable library this does not fail yet, because ``gva-mi doctor`` reports it: the
    reason is kept, and :func:`require` raises it before Dr.Jit is used.
    """
    global problem
    if "drjit" in sys.modules:
        _check_loaded()
        return
    try:
        chosen = os.environ.get(PATH)
        if chosen is None:
            os.environ[PATH] = str(find())
        else:
            _check_chosen(Path(chosen))
    except ImportError as error:
        problem = str(error)


def require() -> None:
    """Raise the error that :func:`prepare` kept; every package that needs Dr.Jit calls this."""
    if problem:
        raise ImportError(problem)


def find() -> Path:
    """Return the newest usable library; raise an ImportError that names a package to install."""
    found = {path: major for path in installed() if (major := major_of(path)) is not None}
    usable = [path for path, major in found.items() if major >= OLDEST]
    if usable:
        return max(usable, key=lambda path: (found[path] in PREFERRED, found[path]))
    seen = ", ".join(sorted(map(str, set(found.values())))) or "none"
    raise ImportError(
        f"Dr.Jit needs libLLVM {OLDEST} or newer, and this machine has: {seen} "
        f"(15 and 16 abort the process). Install it: apt-get install {PACKAGE}"
    )


def installed() -> list[Path]:
    """Return every ``libLLVM`` in the usual places."""
    folders = [*map(Path, SEARCH_DIRS), *sorted(Path("/usr/lib").glob("llvm-*/lib"))]
    names = "libLLVM*.so*", "libLLVM*.dylib"
    found = (path for folder in folders for name in names for path in sorted(folder.glob(name)))
    return [path for path in found if path.exists()]


def major_of(path: Path) -> int | None:
    """Return the major version of a library by its name; None where no name says it."""
    for name in (path.name, path.resolve().name):
        if found := re.search(VERSION_IN_NAME, name):
            return int(found.group(1))
    return _major_inside(path)


def _major_inside(path: Path) -> int | None:
    """Return the major version in the SONAME of a library whose file has another name."""
    try:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as held:
            found = re.search(VERSION_IN_NAME.encode(), held)
            return int(found.group(1)) if found else None
    except (OSError, ValueError):  # no such file, or an empty one
        return None


def _check_chosen(path: Path) -> None:
    """Raise an ImportError if a library that the user chose is missing or too old."""
    major = major_of(path)
    fault = None if path.exists() else "there is no such file"
    if major is not None and major < OLDEST:
        fault = f"it is libLLVM {major}, with which kernels abort the process"
    if fault:
        raise ImportError(
            f"{PATH}={path} cannot be used: {fault}. "
            f"Unset it, or point it to a libLLVM {OLDEST} or newer."
        )


def _check_loaded() -> None:
    import drjit as dr

    version = dr.detail.llvm_version()
    if version[0] < OLDEST:
        found = "no libLLVM" if version[0] < 0 else "libLLVM " + ".".join(map(str, version))
        raise ImportError(
            f"drjit (or mitsuba) was imported before gva_mi and found {found}, where {OLDEST} or "
            f"newer is needed (15 and 16 abort the process). Import gva_mi first, or install "
            f"{PACKAGE} and set {PATH} before the first import."
        )
