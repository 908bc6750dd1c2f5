"""Use of the CPU: the same bits on every x86 CPU with AVX2, and cores shared by torch and Dr.Jit.

OpenBLAS (numpy, scipy), MKL, oneDNN, numpy's and torch's own kernels choose their code by the CPU,
and each choice rounds in another order. These settings, made before the libraries are imported,
choose the code that all CPUs with AVX2 can run. MKL uses its AVX2 code only on Intel's CPUs; its
branch for all makers is called COMPATIBLE. No setting reaches torch's ``sqrt``,
``acos``, ``asin`` and ``atan``: this package has :func:`sqrt` and uses none of the others. Dr.Jit
compiles for the CPU's own vectors and gives the same bits for any vector width, except for
``rsqrt``, which every CPU estimates in its own way. Therefore no kernel of this package uses it.

Torch runs on one thread, which makes every sum independent of the number of threads.
"""

from __future__ import annotations

import ctypes
import functools
import os
import platform
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

if TYPE_CHECKING:  # importing torch would be too early for the settings
    import torch

OMP_PAUSE_SOFT = 1  # OpenMP's omp_pause_soft: settings are kept
# Kept, because torch allocates its memory anew in every new thread.
_THREAD = ThreadPoolExecutor(1, "torch")

Result = TypeVar("Result")
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


def sqrt(x: torch.Tensor) -> torch.Tensor:
    """Return √x of the same shape, with the same bits on every CPU.

    On tensors, ``sqrt``, ``acos``, ``asin`` and ``atan`` call MKL's vector functions. These begin
    with the CPU's own estimate of 1/x or 1/√x, so their last digits differ between makers. This
    function takes a square root and two divisions, which IEEE 754 rounds. Therefore
    ``tests/core/test_cpu.py`` forbids the four functions on tensors.

    Note:
        Autograd computes the gradient 1/(2√x) as x^(-3/2) · x / 2. It is the gradient of
        ``x.sqrt()`` up to rounding, except where x^(-3/2) overflows: below 2e-26 in float32 and
        3e-206 in float64 it is inf, and at 0 it is inf · 0 = nan, where ``x.sqrt()`` has inf.
        Optimisers can use neither, and the norm of a zero vector has the gradient nan with both. A
        caller that may meet 0 replaces it first, as ``splat/gsplat/views.py`` does.
    """
    return x.rsqrt().reciprocal()


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Run torch on one thread, so that its OpenMP threads do not spin on Dr.Jit's cores.

    On two cores one thread is 1.3 to 20 times faster for tensors as small as ours, the more the
    busier the cores are, and it makes every sum independent of the number of threads.
    """
    import torch

    before = torch.get_num_threads()
    if before > 1:
        torch.set_num_threads(1)
    try:
        yield
    finally:
        if before > 1:
            torch.set_num_threads(before)


@contextmanager
def one_thread() -> Iterator[None]:
    """Run torch and Dr.Jit on one thread each, for small kernels such as a mesh's picture.

    A second thread of Dr.Jit makes them a fifth faster, and costs half more CPU, because it mostly
    waits for the next kernel. On a busy machine both times double.
    """
    with _drjit_threads(1), one_torch_thread():
        yield


@contextmanager
def core_for_torch() -> Iterator[None]:
    """Run Dr.Jit on one thread less, so that torch has a core for :func:`in_torch_thread`.

    Threads of Dr.Jit spin for milliseconds before they sleep. On two cores, torch on two threads
    takes twice as long right after a kernel. To end a thread and to start it again takes 0.2 ms.
    """
    import drjit as dr

    with _drjit_threads(max(1, dr.thread_count() - 1)):
        yield


@contextmanager
def _drjit_threads(count: int) -> Iterator[None]:
    import drjit as dr

    before = dr.thread_count()
    dr.set_thread_count(count)
    try:
        yield
    finally:
        dr.set_thread_count(before)


def in_torch_thread(work: Callable[..., Result], *inputs: torch.Tensor) -> Future[Result]:
    """Start a computation of torch in another thread, which counts torch's threads as this one.

    torch chooses some algorithms by that number, so a call in this thread gives the same bits.
    Gradients are enabled in the other thread.
    """
    import torch

    threads = torch.get_num_threads()

    def run() -> Result:
        if torch.get_num_threads() != threads:  # a setting of each thread
            torch.set_num_threads(threads)
        return work(*inputs)

    return _THREAD.submit(run)


@contextmanager
def quiet_openmp() -> Iterator[None]:
    """End torch's idle OpenMP threads, then run torch on one thread.

    Idle threads spin for milliseconds while they wait for torch's next operation, on the cores that
    Dr.Jit's kernels need: on two cores a step of 20,000 Gaussians at 512 x 512 pixels takes a tenth
    longer beside them. They sleep if ``OMP_WAIT_POLICY=PASSIVE`` was set before torch was imported,
    as the command line does; OpenMP's ``omp_pause_resource_all`` ends them whatever was imported
    first. OpenMP starts as many threads again with the next operation that wants them.
    """
    import torch

    pause = _pause_of_openmp()
    if pause is not None and torch.get_num_threads() > 1:
        pause(OMP_PAUSE_SOFT)
    with one_torch_thread():
        yield


@functools.cache
def _pause_of_openmp() -> Callable[[int], int] | None:
    """Return ``omp_pause_resource_all`` of the OpenMP that torch is linked with, if it has one."""
    import torch

    for library in (Path(torch.__file__).parent / "lib").glob("libtorch_cpu.*"):
        pause = getattr(ctypes.CDLL(str(library)), "omp_pause_resource_all", None)
        if pause is not None:
            pause.argtypes, pause.restype = [ctypes.c_int], ctypes.c_int
            return pause
    return None
