"""Run independent tasks in this process, in worker processes, or on a cluster.

A task holds all that its result depends on, so that it gives the same bits wherever it runs. Any
:class:`concurrent.futures.Executor` can run tasks:

* :func:`workers`: processes on this machine, which share its cores;
* :func:`cluster`: a dask.distributed scheduler (extra ``[cluster]``). Its workers need the same
  packages; images and the body travel with the task, and no shared file system is needed.
"""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from gva_mi.core.console import Progress, within
from gva_mi.core.errors import InputError, reason_of
from gva_mi.core.threads import one_torch_thread
from gva_mi.core.workers import worker_died, worker_processes

CONNECT = 10  # seconds to wait for a scheduler

Result = TypeVar("Result", covariant=True)

# A cluster's worker may have several threads, of which one may work at a time. The lock is
# re-entrant because a task of a study refines videos, whose tasks are solved in the same thread.
_one_at_a_time = threading.RLock()


class Task(Protocol[Result]):
    """Work that can be done anywhere; it must be possible to pickle it."""

    @property
    def steps(self) -> int:
        """The amount of work, for progress."""
        ...

    def solve(self, progress: Progress | None = None) -> Result:
        """Do the work in this process."""
        ...


@dataclass(frozen=True)
class Done(Generic[Result]):
    """The result of a task."""

    result: Result
    seconds: float  # of work


def solve(task: Task[Result], progress: Progress | None = None) -> Done[Result]:
    """Solve a task in this process, while no other thread solves one."""
    with _one_at_a_time, one_torch_thread():
        begin = time.perf_counter()
        result = task.solve(progress)
        return Done(result, time.perf_counter() - begin)


def run(
    tasks: Sequence[Task[Result]],
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Iterator[Done[Result]]:
    """Solve tasks and yield their results in order; without an executor in this process.

    ``progress`` is called with the steps of all tasks.
    """
    total, before = sum(task.steps for task in tasks), 0
    futures = [] if executor is None else [executor.submit(solve, task) for task in tasks]
    try:
        for number, task in enumerate(tasks):
            of_task = within(progress, before, task.steps, total)
            if executor is None:
                yield solve(task, of_task)
            else:
                done = _result(futures[number])
                if of_task is not None:
                    of_task(task.steps, task.steps)
                yield done
            before += task.steps
    finally:
        for future in futures:
            future.cancel()


def _result(future: Future[Done[Result]]) -> Done[Result]:
    """Wait for a result; raise an InputError if the worker is gone."""
    try:
        return future.result()
    except Exception as error:
        # distributed has its own errors for workers that were lost repeatedly.
        theirs = type(error).__module__.split(".")[0] == "distributed"
        if not theirs and not isinstance(error, BrokenExecutor | CancelledError):
            raise
        raise worker_died(error) from None


@contextmanager
def workers(count: int) -> Iterator[Executor | None]:
    """Start an executor of ``count`` processes; for one, yield None: this process itself."""
    if count < 1:
        raise InputError(f"refine: --workers must be at least 1, got {count}")
    if count == 1:
        yield None
        return
    threads = max(1, (os.cpu_count() or 1) // count)
    with worker_processes(count, _start_worker, threads) as pool:
        yield pool


@contextmanager
def cluster(address: str) -> Iterator[Executor]:
    """Connect to a dask.distributed scheduler, such as ``tcp://10.0.0.1:8786``."""
    try:
        import dask
        from distributed import Client
    except ImportError:
        raise InputError(
            "refine: --scheduler needs the package distributed, which is not installed: "
            "pip install 'gva_mi[cluster]'"
        ) from None
    try:
        client = Client(address, timeout=CONNECT, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"refine: no scheduler answers at {address} ({reason_of(error)})"
        ) from None
    # Tasks hold images and the body; dask's warning above 10 MB is no help here.
    large = {"distributed.admin.large-graph-warning-threshold": "1GB"}
    with client, dask.config.set(large):
        yield client.get_executor(pure=False)


def _start_worker(threads: int) -> None:
    import drjit as dr

    dr.set_thread_count(threads)
