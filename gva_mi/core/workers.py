"""Worker processes that share work on this machine and never outlive their parent.

* If the parent is killed, its workers notice and end at once, so none goes on writing where the
  next run of the same command writes. (loky's workers do not; that is why this is not loky.)
* Ctrl-C reaches every process of a terminal. Workers ignore it; the parent tells them to stop, and
  kills one that has not cleaned up after :data:`GRACE` seconds.
* If a worker dies, the waiting caller gets ``BrokenExecutor``; :func:`worker_died` explains it.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from typing import Any

from gva_mi.core.errors import InputError, reason_of

GRACE = 5.0  # seconds


def usual_workers() -> int:
    """Return how many processes a command uses unless told: few, as each takes a gigabyte."""
    return min(4, os.cpu_count() or 1)


@contextmanager
def worker_processes(
    count: int,
    begin: Callable[..., None],
    *given: Any,  # noqa: ANN401
) -> Iterator[ProcessPoolExecutor]:
    """Yield an executor whose processes end with this context.

    Each of them first calls ``begin``, which must be picklable as its arguments.
    """
    context = multiprocessing.get_context("spawn")  # Dr.Jit's threads do not survive a fork
    others = set(multiprocessing.active_children())
    pool = _Pool(count, context, _begin, (begin, given))
    try:
        yield pool
    except BaseException:
        # shutdown() waits for running work, and for ever for a worker killed while it answers.
        cancelled = {"cancel_futures": True}
        closing = threading.Thread(target=pool.shutdown, kwargs=cancelled, daemon=True)
        closing.start()
        _stop([p for p in multiprocessing.active_children() if p not in others])
        closing.join(GRACE)
        raise
    pool.shutdown(cancel_futures=True)


@contextmanager
def local_executor(count: int) -> Iterator[ProcessPoolExecutor | None]:
    """Yield an executor of ``count`` processes that share the cores; of one, None: this process."""
    if count == 1:
        yield None
        return
    threads = max(1, (os.cpu_count() or 1) // count)
    with worker_processes(count, _set_drjit_threads, threads) as pool:
        yield pool


def _set_drjit_threads(threads: int) -> None:
    import drjit as dr

    dr.set_thread_count(threads)


class _Pool(ProcessPoolExecutor):
    """An executor that starts its processes with Ctrl-C blocked until they can handle it."""

    def submit(self, work: Callable[..., Any], /, *given: Any, **named: Any) -> Future:  # noqa: ANN401
        with _ctrl_c_held():
            return super().submit(_do, work, *given, **named)  # which starts the processes


@contextmanager
def _ctrl_c_held() -> Iterator[None]:
    """Delay Ctrl-C for this process, and block it in processes started within."""
    came: list[int] = []
    here = threading.current_thread() is threading.main_thread()
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))  # children inherit it
    # Another thread may receive the signal; its Python handler still runs in the main thread.
    handler = signal.signal(signal.SIGINT, lambda number, _: came.append(number)) if here else None
    try:
        yield
    finally:
        if here:
            signal.signal(signal.SIGINT, handler or signal.SIG_DFL)  # None: set by a C program
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        if came:
            signal.raise_signal(signal.SIGINT)


def worker_died(error: BaseException) -> InputError:
    """Return the sentence for a worker that died before its work was done."""
    return InputError(
        f"a worker process is gone ({reason_of(error)}): killed, or out of "
        "memory; every file that is there is whole; run it again, with fewer workers where "
        "memory is short"
    )


def _stop(workers: Sequence[BaseProcess]) -> None:
    """Terminate processes, and kill those that take longer than :data:`GRACE`."""
    for worker in workers:
        worker.terminate()
    left, until = {worker.sentinel: worker for worker in workers}, time.monotonic() + GRACE
    while left and (ended := wait(list(left), max(0.0, until - time.monotonic()))):
        for sentinel in ended:
            del left[sentinel]
    for worker in left.values():
        worker.kill()


def _begin(begin: Callable[..., None], given: Sequence[Any]) -> None:
    """Prepare a worker: ignore Ctrl-C, watch the parent, call ``begin``."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGINT,))
    threading.Thread(target=_end_with_parent, daemon=True).start()
    begin(*given)


class _Stopped(SystemExit):
    """Ends a worker silently; whatever it is doing cleans up."""


def _stop_here(*_: object) -> None:
    raise _Stopped


def _do(work: Callable[..., Any], *given: Any, **named: Any) -> Any:  # noqa: ANN401
    """Run one piece of work; exit the worker if it was told to stop meanwhile."""
    signal.signal(signal.SIGTERM, _stop_here)
    try:
        return work(*given, **named)
    except _Stopped:
        os._exit(1)  # Dr.Jit's own cleanup may hang after interrupted kernels
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)  # nothing to clean up between two pieces


def _end_with_parent() -> None:
    multiprocessing.parent_process().join()
    os._exit(1)
