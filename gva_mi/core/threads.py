"""Threads of torch and of Dr.Jit."""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import TypeVar

import torch

OMP_PAUSE_SOFT = 1  # OpenMP's omp_pause_soft: settings are kept
# Kept, because torch allocates its memory anew in every new thread.
_THREAD = ThreadPoolExecutor(1, "torch")

Result = TypeVar("Result")


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Run torch on one thread, so that its OpenMP threads do not spin on Dr.Jit's cores.

    On two cores one thread is 1.3 to 20 times faster for tensors as small as ours, the more the
    busier the cores are, and it makes every sum independent of the number of threads.
    """
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
    """Run torch and Dr.Jit on one thread each, for kernels as small as those of a mesh's picture.

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

    torch chooses some algorithms by that number, so the bits are those of a call in this thread.
    Gradients are on there, whatever they are here.
    """
    threads = torch.get_num_threads()

    def run() -> Result:
        if torch.get_num_threads() != threads:  # a setting of each thread
            torch.set_num_threads(threads)
        return work(*inputs)

    return _THREAD.submit(run)


@contextmanager
def quiet_openmp() -> Iterator[None]:
    """End torch's idle OpenMP threads, then run torch on one thread.

    Idle threads spin while they wait for torch's next operation. On a core that Dr.Jit's kernels
    need they cost milliseconds, unless ``OMP_WAIT_POLICY=PASSIVE`` was set before torch was
    imported. OpenMP's own call ends them whatever was imported first. No setting changes: the same
    number of threads comes back with the next operation that wants them.
    """
    pause = _pause()
    if pause is not None and torch.get_num_threads() > 1:
        pause(OMP_PAUSE_SOFT)
    with one_torch_thread():
        yield


@functools.cache
def _pause() -> Callable[[int], int] | None:
    """Return ``omp_pause_resource_all`` of the OpenMP that torch is linked with, if it has one."""
    for library in (Path(torch.__file__).parent / "lib").glob("libtorch_cpu.*"):
        pause = getattr(ctypes.CDLL(str(library)), "omp_pause_resource_all", None)
        if pause is not None:
            pause.argtypes, pause.restype = [ctypes.c_int], ctypes.c_int
            return pause
    return None
