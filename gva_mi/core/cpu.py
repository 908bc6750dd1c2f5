"""Settings that make numerical libraries compute the same bits on every x86 CPU with AVX2.

OpenBLAS (numpy, scipy), MKL, oneDNN, numpy's and torch's own kernels choose their code by the CPU,
and each choice rounds in another order. These settings, made before the libraries are imported,
choose the code that all CPUs with AVX2 have. MKL takes its AVX2 code on Intel's CPUs alone; the
branch that it has for all makers is called COMPATIBLE. What no setting reaches is in
:mod:`gva_mi.core.same_bits`. Dr.Jit compiles for the CPU's own vectors and gives the same bits for
any vector width, except for ``rsqrt``, which every CPU estimates in its own way. Therefore no
kernel of this package uses it.
"""

from __future__ import annotations

import os
import platform
from importlib import metadata
from pathlib import Path

SETTINGS = {
    "OPENBLAS_CORETYPE": "Haswell",
    "MKL_CBWR": "COMPATIBLE",
    "ONEDNN_MAX_CPU_ISA": "AVX2",
    "ATEN_CPU_CAPABILITY": "avx2",
}
LEFT_OUT_BY_NUMPY = "NPY_DISABLE_CPU_FEATURES"  # the name of a variable
WIDER_THAN_AVX2 = "X86_V4 AVX512_ICL AVX512_SPR"  # numpy's names of its code since 2.4
WIDER_BEFORE_2_4 = "AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL"
REQUIRED_FLAGS = {"avx2", "fma"}
_FLAGS = Path("/proc/cpuinfo")


def cpu_settings() -> dict[str, str]:
    """Return the settings for ``os.environ``; empty if the CPU has no AVX2, or is unknown."""
    if platform.machine() not in ("x86_64", "AMD64") or not _FLAGS.exists():
        return {}
    flags = next((line for line in _FLAGS.read_text().splitlines() if line.startswith("flags")), "")
    if not set(flags.split()) >= REQUIRED_FLAGS:
        return {}
    if "avx512f" not in flags.split():
        return SETTINGS
    major, minor = metadata.version("numpy").split(".")[:2]  # which is not imported
    wider = WIDER_THAN_AVX2 if (int(major), int(minor)) >= (2, 4) else WIDER_BEFORE_2_4
    return SETTINGS | {LEFT_OUT_BY_NUMPY: wider}


def pin_cpu_features() -> None:
    """Apply the settings to this process and its children, except where the user set others."""
    for name, value in cpu_settings().items():
        os.environ.setdefault(name, value)
