"""Settings that make numerical libraries compute the same bits on every x86 CPU with AVX2.

OpenBLAS (numpy, scipy), MKL, oneDNN and torch's own kernels choose their code by the CPU, and each
choice sums in another order. These settings, made before the libraries are imported, choose the
code that all CPUs with AVX2 have. Dr.Jit compiles for the CPU's own vectors and gives the same bits
for any vector width, except for ``rsqrt``, which every CPU estimates in its own way. Therefore no
kernel of this package uses it.
"""

from __future__ import annotations

import os
import platform
from pathlib import Path

SETTINGS = {
    "OPENBLAS_CORETYPE": "Haswell",
    "MKL_CBWR": "AVX2",
    "ONEDNN_MAX_CPU_ISA": "AVX2",
    "ATEN_CPU_CAPABILITY": "avx2",
}
REQUIRED_FLAGS = {"avx2", "fma"}
_FLAGS = Path("/proc/cpuinfo")


def cpu_settings() -> dict[str, str]:
    """Return the settings for ``os.environ``; empty if the CPU has no AVX2, or is unknown."""
    if platform.machine() not in ("x86_64", "AMD64") or not _FLAGS.exists():
        return {}
    flags = next((line for line in _FLAGS.read_text().splitlines() if line.startswith("flags")), "")
    return SETTINGS if REQUIRED_FLAGS <= set(flags.split()) else {}


def pin_cpu_features() -> None:
    """Apply the settings to this process and its children, except where the user set others."""
    for name, value in cpu_settings().items():
        os.environ.setdefault(name, value)
