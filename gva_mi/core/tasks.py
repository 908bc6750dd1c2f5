"""Run independent tasks in this process, in processes that share its cores, or on a cluster.

A task holds all that its result depends on, so that it gives the same bits wherever it runs. Worker
processes never outlive their parent:

* If the parent is killed, its workers notice and end at once, so none goes on writing where the
  next run of the same command writes. (loky's workers do not; that is why this is not loky.)
* Ctrl-C reaches every process of a terminal. Workers ignore it; the parent kills them, which is
  safe because every file is whole at any moment.
* If a worker dies, the waiting caller gets one sentence about it.

A cluster is one of dask.distributed (extra ``cluster``): its workers may be on many machines, and
do what a lost worker left undone. All of them must see the same files.
"""

from __future__ import annotations

import logging
import math
import multiprocessing
import os
import pickle
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
)
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import cycle
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

from gva_mi.core.console import Progress, part_of_progress, say
from gva_mi.core.cpu import one_torch_thread
from gva_mi.core.errors import InputError, reason_of

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

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
                done = _result_of(futures[number])
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
    for item in items:
        waiting.append(pool.submit(work, item))
        if len(waiting) > ahead:
            yield _result_of(waiting.popleft())
    while waiting:
        yield _result_of(waiting.popleft())


def on_all_cores(work: Callable[[Item], Result], items: Iterable[Item]) -> Iterator[Result]:
    """Yield the results of ``work``, in order, from a thread on each core.

    Worth it when the work releases Python's lock, as numpy, SciPy and Pillow do on large arrays.
    """
    cores = os.cpu_count() or 1
    with ThreadPoolExecutor(cores) as pool:
        yield from in_order(pool, work, items, cores + 1)


def usual_workers() -> int:
    """Return how many processes a command uses by default: few, as each takes a gigabyte."""
    return min(4, os.cpu_count() or 1)


@contextmanager
def local_executor(count: int) -> Iterator[ProcessPoolExecutor | None]:
    """Yield an executor of ``count`` processes that share the cores.

    For one process it is None: this process does the work itself.
    """
    if count == 1:
        yield None
        return
    threads = max(1, (os.cpu_count() or 1) // count)
    with worker_processes(count, _set_drjit_threads, threads) as pool:
        yield pool


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
    pool = ProcessPoolExecutor(count, context, _begin, (begin, given))
    try:
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # workers inherit it
        try:
            for _ in range(count):
                pool.submit(int)  # starts a process
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        yield pool
    except BaseException:
        for worker in set(multiprocessing.active_children()) - others:
            worker.kill()
        pool.shutdown(wait=False, cancel_futures=True)
        raise
    pool.shutdown(cancel_futures=True)


class _ByTurns(Executor):
    """An executor that gives its work to others, one after another."""

    def __init__(self, pools: Sequence[Executor]) -> None:
        self._turns = cycle(pools)

    def submit(self, work: Callable[..., Result], /, *given: Any) -> Future[Result]:  # noqa: ANN401
        return next(self._turns).submit(work, *given)


class Helpers:
    """Processes that take shares of the items that this process works on."""

    def __init__(self, pools: Sequence[Executor] = ()) -> None:
        """Use executors of one process each."""
        self._pools = pools

    def __len__(self) -> int:
        return len(self._pools)

    def share(
        self,
        make: Callable[..., Callable[[Sequence[Item]], list[Result]]],
        *given: Any,  # noqa: ANN401
    ) -> Callable[[Sequence[Item]], list[Result]]:
        """Return a function of items that each process shares from when it is ready.

        Args:
            make: makes the function in a process, from ``given``. The result of an item depends on
                the item alone. All that processes exchange must be possible to pickle.
        """
        here, starting = make(*given), self._made(make, given)

        def shared(items: Sequence[Item]) -> list[Result]:
            try:
                return divided(items)
            except BrokenExecutor as error:
                raise worker_died(error) from None

        def divided(items: Sequence[Item]) -> list[Result]:
            ready = [pool for pool, made in starting.items() if made.done() and made.result()]
            count, found = len(ready) + 1, list(items)
            futures = [
                pool.submit(_do_work, share)
                for k, pool in enumerate(ready, 1)
                if (share := items[k::count])
            ]
            found[::count] = here(items[::count])
            for k, future in enumerate(futures, 1):
                found[k::count] = future.result()
            return found

        return shared

    def in_order(
        self,
        make: Callable[..., Callable[[Sequence[Item]], list[Result]]],
        *given: Any,  # noqa: ANN401
    ) -> Callable[[Iterable[Item]], Iterator[Result]]:
        """Return a function that yields the results of items in order, one process after another.

        ``make`` and ``given`` are as for :meth:`share`; this process does none of the work.
        """
        pool, ahead = _ByTurns(tuple(self._made(make, given))), 2 * len(self)

        def results(items: Iterable[Item]) -> Iterator[Result]:
            for (result,) in in_order(pool, _do_work, ([item] for item in items), ahead):
                yield result

        return results

    def _made(self, make: Callable[..., Any], given: Sequence[Any]) -> dict[Executor, Future[bool]]:
        """Let each process make a function; return the futures of that."""
        # By value: queues would pass each tensor of torch as an open file.
        recipe = pickle.dumps((make, given), pickle.HIGHEST_PROTOCOL) if self._pools else b""
        return {pool: pool.submit(_make_work, recipe) for pool in self._pools}


@contextmanager
def helper_processes(workers: int, pays: bool) -> Iterator[Helpers]:
    """Yield the helpers of one of ``workers`` processes, which end with this context.

    Each has one thread. A process takes 4 s to start; there are none unless that ``pays``.
    """
    with ExitStack() as stack:
        pools = [worker_processes(1, _on_one_thread) for _ in range(workers - 1 if pays else 0)]
        yield Helpers([stack.enter_context(pool) for pool in pools])


MOST_THREADS = 1  # of a cluster's worker: torch and Dr.Jit expect to be alone in a process
CONNECT = 10  # seconds; chosen: a scheduler that answers later is none


@contextmanager
def cluster(
    scheduler: str | None, workers: int, same: Callable[[], dict[str, str | None]]
) -> Iterator[Client]:
    """Yield a client of a cluster's workers.

    Args:
        scheduler: address of a running one, such as ``tcp://10.0.0.1:8786``; None: one with new
            ``workers`` on this machine, which end with this context.
        workers: processes on this machine.
        same: what must be the same in all workers and here, by name: versions and settings.

    Raises:
        InputError: the package is missing, no scheduler or worker answers, or one differs.
    """
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        raise InputError(
            "a cluster needs the package distributed: pip install 'gva_mi[cluster]'"
        ) from None
    with ExitStack() as stack:
        there: LocalCluster | str | None = scheduler
        if there is None:
            free = "127.0.0.1:0"  # any port
            local = LocalCluster(
                workers,
                threads_per_worker=MOST_THREADS,
                dashboard_address=free,
                host="127.0.0.1",
                silence_logs=logging.ERROR,  # not of workers that end slowly
            )
            there = stack.enter_context(local)
        try:
            client = Client(there, timeout=CONNECT)
        except (OSError, ValueError) as error:
            raise InputError(
                f"{scheduler}: no scheduler answers ({reason_of(error)}); expected an address "
                "such as tcp://10.0.0.1:8786"
            ) from None
        stack.enter_context(client)
        _require_workers(client, same)
        yield client


def _require_workers(client: Client, same: Callable[[], dict[str, str | None]]) -> None:
    """Say what the workers are, and raise an InputError unless they suit."""
    try:
        client.wait_for_workers(1, timeout=CONNECT)
        found, here = client.run(same), same()
    except (TimeoutError, ImportError, AttributeError) as error:
        raise InputError(
            f"the cluster has no worker with this program ({reason_of(error)}); install the same "
            "gva_mi on all machines"
        ) from None
    for address, theirs in found.items():
        for name, ours in here.items():
            if theirs.get(name) != ours:
                raise InputError(
                    f"{address}: has {name} {theirs.get(name)}, and this machine has {ours}; "
                    "results would differ, so install and set the same on all machines"
                )
    about = client.scheduler_info(n_workers=-1)["workers"].values()
    if any(worker["nthreads"] > MOST_THREADS for worker in about):
        raise InputError("the cluster's workers have several threads; start them with --nthreads 1")
    memory = min(worker["memory_limit"] or math.inf for worker in about) / 2**30
    say(f"{len(about)} workers with {memory:.1f} GiB of memory each; {client.dashboard_link}")


def end_with_input() -> None:
    """End this process when its standard input ends, as it does if the parent process is killed."""

    def watch() -> None:
        while os.read(0, 1):
            pass
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _begin(begin: Callable[..., None], given: Sequence[Any]) -> None:
    """Prepare a worker: ignore Ctrl-C, watch the parent, call ``begin``."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    threading.Thread(target=_end_with_parent, daemon=True).start()
    begin(*given)


def _end_with_parent() -> None:
    multiprocessing.parent_process().join()
    os._exit(1)


def _set_drjit_threads(threads: int) -> None:
    import drjit as dr

    dr.set_thread_count(threads)


_work: Callable[[Sequence[Any]], list[Any]] | None = None  # of a helper process


def _on_one_thread() -> None:
    import torch

    torch.set_num_threads(1)
    _set_drjit_threads(1)


def _make_work(recipe: bytes) -> bool:
    """Prepare this process for :func:`_do_work`; return True once it is ready."""
    global _work
    make, given = pickle.loads(recipe)
    _work = make(*given)
    return True


def _do_work(items: Sequence[Any]) -> list[Any]:
    return _work(items)


def _result_of(future: Future[Result]) -> Result:
    try:
        return future.result()
    except Exception as error:
        lost = type(error).__module__.split(".")[0] == "distributed"  # workers, again and again
        if not lost and not isinstance(error, BrokenExecutor | CancelledError):
            raise
        raise worker_died(error) from None


def worker_died(error: BaseException) -> InputError:
    """Return the sentence for a worker that died before its work was done."""
    return InputError(
        f"a worker process died ({reason_of(error)}): killed, or out of memory; all files on disk "
        "are complete; run the command again, with fewer workers if memory is short"
    )
