"""Processes of this machine that share work, and never outlive the one that has it.

* Where that one is killed, they see it and end at once: none goes on writing where the next run of
  the same command writes.
* Ctrl-C, which a terminal sends to all of them, is left to the first. It tells the others to stop;
  one that has not cleared up after :data:`GRACE` seconds is killed.
* Where one of them is killed, or runs out of memory, whoever waits for it gets one of :data:`LOST`,
  for which :func:`lost` has words.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Future, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from typing import Any

from gva_mi.errors import InputError, reason_of

GRACE = 5.0  # seconds


class Stopped(SystemExit):
    """Somebody told a worker to stop: it ends without a word."""


LOST = (BrokenExecutor, Stopped)


@contextmanager
def processes(count: int, begin: Callable[..., None], *given: Any) -> Iterator[ProcessPoolExecutor]:  # noqa: ANN401
    """An executor of ``count`` processes, which end with this context.

    Args:
        count: of processes.
        begin: what each calls first.
        given: to ``begin``; it must be possible to pickle both.
    """
    context = multiprocessing.get_context("spawn")  # Dr.Jit's threads do not survive a fork
    others = set(multiprocessing.active_children())
    pool = _Pool(count, context, _begin, (begin, given))
    try:
        yield pool
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)  # it would wait for what they are doing
        _stop([p for p in multiprocessing.active_children() if p not in others])
        raise
    pool.shutdown(cancel_futures=True)


class _Pool(ProcessPoolExecutor):
    """Its processes start with Ctrl-C held back, until they know what to do about it."""

    def submit(self, *work: Any, **options: Any) -> Future:  # noqa: ANN401
        before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))
        try:
            return super().submit(*work, **options)  # which starts them, one by one
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def lost(error: BaseException) -> InputError:
    """What to say of a worker that ended before its work did."""
    return InputError(
        f"a worker process, or the scheduler, is gone ({reason_of(error)}): killed, or out of "
        "memory; every file that is there is whole; run it again, with fewer workers where "
        "memory is short"
    )


def _stop(workers: Sequence[BaseProcess]) -> None:
    """End processes: by their own hand, or by force where that takes long."""
    for worker in workers:
        worker.terminate()
    left, until = {worker.sentinel: worker for worker in workers}, time.monotonic() + GRACE
    while left and (ended := wait(list(left), max(0.0, until - time.monotonic()))):
        for sentinel in ended:
            del left[sentinel]
    for worker in left.values():
        worker.kill()


def _begin(begin: Callable[..., None], given: Sequence[Any]) -> None:
    """What a worker does first."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, (signal.SIGINT,))
    signal.signal(signal.SIGTERM, _stop_here)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    begin(*given)


def _stop_here(*_: object) -> None:
    raise Stopped  # what is being done clears up


def _end_with_parent() -> None:
    multiprocessing.parent_process().join()
    os._exit(1)
