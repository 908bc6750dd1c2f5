"""Finds a libLLVM that Dr.Jit can use, before Dr.Jit is imported.

Dr.Jit loads ``libLLVM`` when it is imported and looks at ``DRJIT_LIBLLVM_PATH`` only then. LLVM 15
and 16 lack the float ``minimum`` and ``maximum`` that Dr.Jit emits: the first such kernel aborts
the whole process, which no ``except`` can catch. So the library is chosen here, by :func:`prepare`,
which ``import gva_mi`` calls.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

OLDEST = 17  # the first major version whose code generator knows fminimum and fmaximum
TESTED = range(19, 23)  # others are tried in a subprocess before they are used
PACKAGE = "libllvm19"  # Debian 12's and Ubuntu 24.04's name of a version that works

SEARCH_DIRS = (
    "/usr/lib/x86_64-linux-gnu",
    "/usr/lib/aarch64-linux-gnu",
    "/usr/lib64",
    "/usr/lib",
    "/usr/local/lib",
    "/opt/homebrew/opt/llvm/lib",
    "/usr/local/opt/llvm/lib",
)

_PATH, _CHECKED = "DRJIT_LIBLLVM_PATH", "GVA_MI_LLVM_CHECKED"

_TRIAL = """
import drjit as dr
from drjit.llvm import Float
x = dr.clip(dr.minimum(dr.opaque(Float, -1, 4), 2), 0, 1)
assert dr.all(x == 0)
print(*dr.detail.llvm_version())
"""


@dataclass(frozen=True)
class Library:
    """One ``libLLVM`` on this machine; ``major`` is 0 where the file name does not tell."""

    path: Path
    major: int


def prepare() -> None:
    """Make sure that Dr.Jit runs on an LLVM that works.

    Raises:
        ImportError: where none was found, the user's own ``DRJIT_LIBLLVM_PATH`` does not work, or
            Dr.Jit was imported before with a library that would abort the process.
    """
    if "drjit" in sys.modules:
        _check_loaded()
        return
    chosen = os.environ.get(_PATH)
    if chosen is None:
        chosen = str(find().path)
    elif os.environ.get(_CHECKED) != chosen:
        problem = trial(Path(chosen))
        if problem:
            raise ImportError(
                f"DRJIT_LIBLLVM_PATH={chosen} cannot be used: {problem}. "
                f"Unset it, or point it to a libLLVM {OLDEST} or newer."
            )
    os.environ[_PATH] = os.environ[_CHECKED] = chosen  # children inherit both and need no trial


def find() -> Library:
    """The newest library that works.

    Raises:
        ImportError: where there is none; it names what was found and the package to install.
    """
    found = sorted(installed(), key=lambda library: library.major, reverse=True)
    for library in found:
        if library.major in TESTED or (library.major >= OLDEST and not trial(library.path)):
            return library
    seen = ", ".join(sorted({str(library.major) for library in found})) or "none"
    raise ImportError(
        f"Dr.Jit needs libLLVM {OLDEST} or newer, and this machine has: {seen} "
        f"(15 and 16 abort the process). Install it: apt-get install {PACKAGE}"
    )


def installed() -> Iterator[Library]:
    """Every ``libLLVM`` in the usual places, oldest first within a folder, each file once."""
    folders = [Path(d) for d in SEARCH_DIRS]
    folders += sorted(Path("/usr/lib").glob("llvm-*/lib"))
    seen = set()
    for folder in folders:
        for path in sorted([*folder.glob("libLLVM*.so*"), *folder.glob("libLLVM*.dylib")]):
            version = re.search(r"libLLVM(?:-|\.so\.)?(\d+)", path.name)
            real = path.resolve()
            if version and real.exists() and real not in seen:
                seen.add(real)
                yield Library(path, int(version.group(1)))


def trial(path: Path) -> str:
    """Run a kernel with a library in a process of its own; returns what went wrong, or ``""``."""
    if not path.exists():
        return "there is no such file"
    environment = {**os.environ, _PATH: str(path)}
    run = subprocess.run(
        [sys.executable, "-c", _TRIAL], env=environment, capture_output=True, text=True, timeout=120
    )
    if run.returncode == 0:
        return ""
    last = (run.stderr.strip().splitlines() or ["no message"])[-1]
    return f"a trial kernel ended with exit code {run.returncode} ({last})"


def _check_loaded() -> None:
    import drjit as dr

    version = dr.detail.llvm_version()
    if version[0] < OLDEST:
        found = "no libLLVM" if version[0] < 0 else "libLLVM " + ".".join(map(str, version))
        raise ImportError(
            f"drjit (or mitsuba) was imported before gva_mi and found {found}, where {OLDEST} or "
            f"newer is needed (15 and 16 abort the process). Import gva_mi first, or install "
            f"{PACKAGE} and set {_PATH} before the first import."
        )
