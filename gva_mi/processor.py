"""Has libraries compute the same bits on every x86 processor since AVX2.

OpenBLAS (numpy, scipy), MKL, oneDNN and torch's own kernels are chosen by the processor they run
on, and sum in another order on each. What is theirs to choose is set here, before they are
imported, to what all such processors have. Dr.Jit compiles for the processor's own vectors, and
gives the same bits for any width of them, but for ``rsqrt``: processors estimate it each in their
own way. So this program's kernels have none.
"""

from __future__ import annotations

import os
import platform
from pathlib import Path

ALIKE = {
    "OPENBLAS_CORETYPE": "Haswell",
    "MKL_CBWR": "AVX2",
    "ONEDNN_MAX_CPU_ISA": "AVX2",
    "ATEN_CPU_CAPABILITY": "avx2",
}
NEEDS = {"avx2", "fma"}
_FLAGS = Path("/proc/cpuinfo")


def alike() -> dict[str, str]:
    """The settings, for ``os.environ``; none for processors that cannot, or nobody knows."""
    if platform.machine() not in ("x86_64", "AMD64") or not _FLAGS.exists():
        return {}
    flags = next((line for line in _FLAGS.read_text().splitlines() if line.startswith("flags")), "")
    return ALIKE if NEEDS <= set(flags.split()) else {}


def choose_alike() -> None:
    """Set them for this process and its children, where the user has not set others."""
    for name, value in alike().items():
        os.environ.setdefault(name, value)
