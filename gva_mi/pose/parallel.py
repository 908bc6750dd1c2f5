"""Independent pieces of a refinement, and who works on them.

A :class:`Job` holds all that its result depends on, so that it may be solved in this process, in
another one, or on another machine, and gives the same bits everywhere. Whoever is a
:class:`concurrent.futures.Executor` can be given jobs:

* :func:`workers`: processes of this machine, which share its cores among them;
* :func:`cluster`: a scheduler of dask.distributed (extra ``[cluster]``). Its workers need the same
  packages; pictures and the body travel with the jobs, and no file system need be shared.
"""

from __future__ import annotations

import multiprocessing
import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch

from gva_mi.body.pose import Pose, Shape
from gva_mi.body.smplx import BodyModel
from gva_mi.errors import InputError
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.pose.evidence import Target
from gva_mi.pose.sequence import Solution, refine_sequence
from gva_mi.pose.single_frame import refine_single_frames
from gva_mi.threads import one_torch_thread

if TYPE_CHECKING:
    from gva_mi.pose.refine import RefineOptions

Progress = Callable[..., None]
CONNECT = 10  # seconds to wait for a scheduler

_one_at_a_time = threading.Lock()  # a worker of a cluster may have several threads


@dataclass(frozen=True)
class Job:
    """Frames to be refined together."""

    targets: dict[int, Target]  # by number within ``pose``
    body: BodyModel
    pose: Pose  # stage 1; frames without a target keep it
    shape: Shape
    options: RefineOptions
    known: Solution | None = None  # what all frames share, where it was found before

    @property
    def steps(self) -> int:
        """How much work it is, for a progress bar."""
        sequence = self.options.loss == "sequence"
        return len(self.targets) * (self.options.passes if sequence else self.options.steps)


@dataclass(frozen=True)
class Solved:
    """What came of a job."""

    solution: Solution
    seconds: float  # of work, whoever did it


def solve(job: Job, progress: Progress | None = None) -> Solved:
    """Do a job in this process."""
    if not job.targets:
        nothing = torch.zeros_like(job.body.v_template)
        rest = Solution(job.pose.rotations, job.pose.transl, nothing, job.shape.betas)
        return Solved(rest, 0.0)
    with _one_at_a_time, one_torch_thread():
        begin = time.perf_counter()
        scene = MeshScene(job.body.faces, job.body.v_template)
        arguments = (job.targets, scene, job.body, job.pose, job.shape, job.options, progress)
        if job.options.loss == "paper":
            solution = refine_single_frames(*arguments)
        else:
            solution = refine_sequence(*arguments, known=job.known)
        return Solved(solution, time.perf_counter() - begin)


def run(
    jobs: Sequence[Job], executor: Executor | None = None, progress: Progress | None = None
) -> Iterator[Solved]:
    """What comes of some jobs, in their order.

    Args:
        jobs: what to do.
        executor: who does it; None: this process, one after the other.
        progress: called as ``progress(done, **figures)`` with the steps done of all these jobs.
    """
    done = 0
    futures = [] if executor is None else [executor.submit(solve, job) for job in jobs]
    try:
        for number, job in enumerate(jobs):
            if executor is None:
                yield solve(job, None if progress is None else _within(progress, done, job.steps))
            else:
                solved = futures[number].result()
                if progress is not None:
                    progress(done + job.steps)
                yield solved
            done += job.steps
    finally:
        for future in futures:
            future.cancel()


def _within(progress: Progress, before: int, steps: int) -> Progress:
    """Progress of one job as that of all."""
    return lambda done, total, **figures: progress(before + steps * done // total, **figures)


@contextmanager
def workers(count: int) -> Iterator[Executor | None]:
    """So many processes of this machine; one is this process itself, for which None stands."""
    if count < 1:
        raise InputError(f"refine: --workers must be at least 1, got {count}")
    if count == 1:
        yield None
        return
    threads = max(1, (os.cpu_count() or 1) // count)
    context = multiprocessing.get_context("spawn")  # Dr.Jit's threads do not survive a fork
    with ProcessPoolExecutor(count, context, _start_worker, (threads,)) as pool:
        try:
            yield pool
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


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
    # Pictures and the body travel with a job, and its warning above 10 MB is of no help here.
    large = {"distributed.admin.large-graph-warning-threshold": "1GB"}
    with client, dask.config.set(large):
        yield client.get_executor(pure=False)


def _start_worker(threads: int) -> None:
    import drjit as dr

    dr.set_thread_count(threads)
