"""How torch and Dr.Jit share the cores."""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import torch

SOFT = 1  # omp_pause_soft: settings stay


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Leave the cores to Dr.Jit: after each operation torch's OpenMP threads would spin on them.

    On two cores one thread is 1.3 to 20 times faster for tensors as small as ours, the more the
    busier the cores are, and it makes every sum independent of their number.
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
def alone_on_the_cores() -> Iterator[None]:
    """As :func:`one_torch_thread`, and the threads that wait for torch's next operation are ended.

    They spin while they wait: on a core that Dr.Jit's kernels need they take milliseconds, unless
    ``OMP_WAIT_POLICY=PASSIVE`` was set before torch was imported, which nobody knows who imports a
    library. This is OpenMP's own call, in any order of imports: no setting changes, and the same
    number of threads comes back with the next operation that wants them.
    """
    pause = _pause()
    if pause is not None and torch.get_num_threads() > 1:
        pause(SOFT)
    with one_torch_thread():
        yield


@functools.cache
def _pause() -> Callable[[int], int] | None:
    """``omp_pause_resource_all`` of the OpenMP that torch is linked with; None: it has none."""
    for library in (Path(torch.__file__).parent / "lib").glob("libtorch_cpu.*"):
        pause = getattr(ctypes.CDLL(str(library)), "omp_pause_resource_all", None)
        if pause is not None:
            pause.argtypes, pause.restype = [ctypes.c_int], ctypes.c_int
            return pause
    return None
