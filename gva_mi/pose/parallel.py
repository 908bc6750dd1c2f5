"""Independent pieces of work, and who does them.

A piece of work holds all that its result depends on, so that it may be done in this process, in
another one, or on another machine, and gives the same bits everywhere. Work can be given to any
:class:`concurrent.futures.Executor`:

* :func:`workers`: processes of this machine, which share its cores among them;
* :func:`cluster`: a scheduler of dask.distributed (extra ``[cluster]``). Its workers need the same
  packages; pictures and the body travel with the work, and no file system need be shared.
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

from gva_mi.console import Progress, within
from gva_mi.errors import InputError
from gva_mi.processes import lost, processes
from gva_mi.threads import one_torch_thread

CONNECT = 10  # seconds to wait for a scheduler

Result = TypeVar("Result", covariant=True)

# A worker of a cluster may have several threads. The one that works may be given a part of its own
# work: a piece of a study holds a refinement, whose pieces are solved here too.
_one_at_a_time = threading.RLock()


class Work(Protocol[Result]):
    """What can be done anywhere; it must be possible to pickle it."""

    @property
    def steps(self) -> int:
        """How much work it is, for progress."""
        ...

    def solve(self, progress: Progress | None = None) -> Result:
        """Do it in this process."""
        ...


@dataclass(frozen=True)
class Done(Generic[Result]):
    """What came of a piece of work."""

    result: Result
    seconds: float  # of work, whoever did it


def solve(work: Work[Result], progress: Progress | None = None) -> Done[Result]:
    """Do a piece of work in this process, while no other thread does one."""
    with _one_at_a_time, one_torch_thread():
        begin = time.perf_counter()
        result = work.solve(progress)
        return Done(result, time.perf_counter() - begin)


def run(
    pieces: Sequence[Work[Result]],
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Iterator[Done[Result]]:
    """What comes of some pieces of work, in their order.

    Args:
        pieces: what to do.
        executor: who does it; None: this process, one after the other.
        progress: called as ``progress(done, total, **figures)`` with the steps of all pieces.
    """
    total, before = sum(work.steps for work in pieces), 0
    futures = [] if executor is None else [executor.submit(solve, work) for work in pieces]
    try:
        for number, work in enumerate(pieces):
            of_piece = within(progress, before, work.steps, total)
            if executor is None:
                yield solve(work, of_piece)
            else:
                done = _result(futures[number])
                if of_piece is not None:
                    of_piece(work.steps, work.steps)
                yield done
            before += work.steps
    finally:
        for future in futures:
            future.cancel()


def _result(future: Future[Done[Result]]) -> Done[Result]:
    """What came of a piece of work that somebody else did.

    Raises:
        InputError: who did it is gone: killed, out of memory, or no longer reached.
    """
    try:
        return future.result()
    except Exception as error:
        # distributed has errors of its own for workers that were lost again and again.
        theirs = type(error).__module__.split(".")[0] == "distributed"
        if not theirs and not isinstance(error, BrokenExecutor | CancelledError):
            raise
        raise lost(error) from None


@contextmanager
def workers(count: int) -> Iterator[Executor | None]:
    """An executor of ``count`` processes of this machine; None, this process itself, for one."""
    if count < 1:
        raise InputError(f"refine: --workers must be at least 1, got {count}")
    if count == 1:
        yield None
        return
    threads = max(1, (os.cpu_count() or 1) // count)
    with processes(count, _start_worker, threads) as pool:
        yield pool


@contextmanager
def cluster(address: str) -> Iterator[Executor]:
    """The workers of a dask.distributed scheduler, such as ``tcp://10.0.0.1:8786``.

    Raises:
        InputError: the package is missing, or nobody answers there.
    """
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
        reason = str(error).splitlines()[0]
        raise InputError(f"refine: no scheduler answers at {address} ({reason})") from None
    # Pictures and the body travel with the work, and dask's warning above 10 MB is of no help here.
    large = {"distributed.admin.large-graph-warning-threshold": "1GB"}
    with client, dask.config.set(large):
        yield client.get_executor(pure=False)


def _start_worker(threads: int) -> None:
    import drjit as dr

    dr.set_thread_count(threads)
