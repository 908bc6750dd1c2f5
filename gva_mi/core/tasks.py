"""Run independent tasks in this process, or in worker processes that share its cores.

A task holds all that its result depends on, so that it gives the same bits wherever it runs.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ThreadPoolExecutor,
)
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from gva_mi.core.console import Progress, part_of_progress
from gva_mi.core.threads import one_torch_thread
from gva_mi.core.workers import worker_died

Item = TypeVar("Item")
Result = TypeVar("Result", covariant=True)


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
    """Solve a task in this process, with one thread of torch."""
    with one_torch_thread():
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
            of_task = part_of_progress(progress, before, task.steps, total)
            if executor is None:
                yield solve(task, of_task)
            else:
                try:
                    done = futures[number].result()
                except (BrokenExecutor, CancelledError) as error:
                    raise worker_died(error) from None
                if of_task is not None:
                    of_task(task.steps, task.steps)
                yield done
            before += task.steps
    finally:
        for future in futures:
            future.cancel()


def in_order(
    pool: Executor, work: Callable[[Item], Result], items: Iterable[Item], ahead: int
) -> Iterator[Result]:
    """Yield the results of ``work`` in the order of its items.

    At most ``ahead`` items are submitted before the first result is taken, because each needs
    memory. Items are taken from their iterator in the caller's thread.
    """
    waiting: deque[Future[Result]] = deque()
    try:
        for item in items:
            waiting.append(pool.submit(work, item))
            if len(waiting) > ahead:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    except BrokenExecutor as error:
        raise worker_died(error) from None


def on_all_cores(work: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Yield the results of ``work``, in order, from a thread on each core.

    This pays where the work is that of numpy, SciPy or Pillow on large arrays, which let other
    threads run meanwhile.
    """
    cores = os.cpu_count() or 1
    with ThreadPoolExecutor(cores) as pool:
        yield from in_order(pool, work, items, cores + 1)
