"""Find a libLLVM that Dr.Jit can use, before Dr.Jit is imported.

Dr.Jit loads ``libLLVM`` when it is imported and reads ``DRJIT_LIBLLVM_PATH`` only then. LLVM 15 and
16 lack the float ``minimum`` and ``maximum`` that Dr.Jit emits: the first such kernel aborts the
whole process. So ``import gva_mi`` calls :func:`prepare`, which chooses the library.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

OLDEST = 17  # the first major version whose code generator knows fminimum and fmaximum
TESTED = range(19, 23)  # others are tried in a subprocess before they are used
PACKAGE = "libllvm19"  # Debian 12's and Ubuntu 24.04's name of a version that works

SEARCH_DIRS = (
    "/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib64", "/usr/lib",
    "/usr/local/lib", "/opt/homebrew/opt/llvm/lib", "/usr/local/opt/llvm/lib",
)  # fmt: skip

PATH, _CHECKED = "DRJIT_LIBLLVM_PATH", "GVA_MI_LLVM_CHECKED"  # environment variables

_TRIAL = """
import drjit as dr
from drjit.llvm import Float
x = dr.clip(dr.minimum(dr.opaque(Float, -1, 4), 2), 0, 1)
assert dr.all(x == 0)
print(*dr.detail.llvm_version())
"""


class Library(NamedTuple):
    """A ``libLLVM`` on this machine."""

    path: Path
    major: int


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
            chosen = str(find().path)
        elif os.environ.get(_CHECKED) != chosen:
            if reason := trial(Path(chosen)):
                raise ImportError(
                    f"{PATH}={chosen} cannot be used: {reason}. "
                    f"Unset it, or point it to a libLLVM {OLDEST} or newer."
                )
    except ImportError as error:
        problem = str(error)
    else:
        os.environ[PATH] = os.environ[_CHECKED] = chosen  # children inherit both: no second trial


def require() -> None:
    """Raise the error that :func:`prepare` kept; every package that needs Dr.Jit calls this."""
    if problem:
        raise ImportError(problem)


def find() -> Library:
    """Return the newest working library; raise an ImportError that names a package to install."""
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
    """Yield every ``libLLVM`` in the usual places once."""
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
    """Run a kernel in a process of its own; return what went wrong, or ``""``."""
    if not path.exists():
        return "there is no such file"
    environment = {**os.environ, PATH: str(path)}
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
            f"{PACKAGE} and set {PATH} before the first import."
        )
