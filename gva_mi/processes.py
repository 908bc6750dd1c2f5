"""Processes of this machine that share work, and never outlive the one that has it.

* Where that one is killed, they see it and end at once: none goes on writing where the next run of
  the same command writes.
* Ctrl-C, which a terminal sends to all of them, is left to the first. It tells the others to stop;
  one that has not cleared up after :data:`GRACE` seconds is killed.
* Where one of them is killed, or runs out of memory, whoever waits for it gets a
  ``BrokenExecutor``, for which :func:`lost` has words.
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

from gva_mi.errors import InputError, reason_of

GRACE = 5.0  # seconds


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
        # It waits for what they do, and perhaps for ever for one that is killed as it answers.
        cancelled = {"cancel_futures": True}
        closing = threading.Thread(target=pool.shutdown, kwargs=cancelled, daemon=True)
        closing.start()
        _stop([p for p in multiprocessing.active_children() if p not in others])
        closing.join(GRACE)
        raise
    pool.shutdown(cancel_futures=True)


class _Pool(ProcessPoolExecutor):
    """Its processes start with Ctrl-C held back, until they know what to do about it."""

    def submit(self, work: Callable[..., Any], /, *given: Any, **named: Any) -> Future:  # noqa: ANN401
        with _ctrl_c_held():
            return super().submit(_do, work, *given, **named)  # which starts them, one by one


@contextmanager
def _ctrl_c_held() -> Iterator[None]:
    """Ctrl-C comes later to this process, and not at all to those that it starts within."""
    came: list[int] = []
    here = threading.current_thread() is threading.main_thread()
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))  # which is inherited
    # Other threads may be given the signal, and the main one then raises what it means.
    handler = signal.signal(signal.SIGINT, lambda number, _: came.append(number)) if here else None
    try:
        yield
    finally:
        if here:
            signal.signal(signal.SIGINT, handler or signal.SIG_DFL)  # None: of a program in C
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        if came:
            signal.raise_signal(signal.SIGINT)


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
    threading.Thread(target=_end_with_parent, daemon=True).start()
    begin(*given)


class _Stopped(SystemExit):
    """This worker is to end, without a word; what it is doing clears up."""


def _stop_here(*_: object) -> None:
    raise _Stopped


def _do(work: Callable[..., Any], *given: Any, **named: Any) -> Any:  # noqa: ANN401
    """A piece of work, after which there is no other for a worker that is to end."""
    signal.signal(signal.SIGTERM, _stop_here)
    try:
        return work(*given, **named)
    except _Stopped:
        os._exit(1)  # Dr.Jit may wait for ever to clear up after kernels that were cut short
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)  # between pieces there is nothing to clear up


def _end_with_parent() -> None:
    multiprocessing.parent_process().join()
    os._exit(1)
