"""The data term of a step's frames, shared among processes.

A frame's loss and its gradient are many small kernels (:func:`gva_mi.core.cpu.one_thread`). So
processes with one thread each take a frame each. Every frame is computed by itself, so any number
of processes finds the same bits.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor
from contextlib import contextmanager

import drjit as dr
import numpy as np
import torch
from torch import Tensor

from gva_mi.core.tasks import worker_died, worker_processes
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.pose.evidence.close_ups import close_ups, parts_of
from gva_mi.pose.evidence.masks_normals import FrameLoss, frame_loss
from gva_mi.pose.job import RefineJob

LEAST = 1000  # frames' losses of a job from which on helpers, which take 4 s to start, pay


class FrameLosses:
    """Losses of frames by the vertices of the body, computed in this process."""

    def __init__(self, job: RefineJob, silhouette: float, weights: Mapping[str, float]) -> None:
        """Prepare the scene.

        Args:
            job: whose evidence the body is compared with.
            silhouette: λ1.
            weights: of the close-ups, by the names of the parts.
        """
        self.given = job, silhouette, weights
        self._scene = MeshScene(job.body.faces, job.body.v_template)
        self._parts = {part: weights[part.name] for part in parts_of(job.body)}

    def __call__(self, frames: Sequence[int], bodies: Tensor, close: bool) -> list[FrameLoss]:
        """Return the loss of each frame, and its gradient by the body.

        Args:
            frames: B numbers.
            bodies: (B, V, 3) vertices, world, metres.
            close: whether close-ups count, where there are some.
        """
        (job, silhouette, _), found = self.given, []
        for k, body in zip(frames, bodies.unbind(), strict=True):
            seen = job.evidence[k]
            views = [(1.0, seen)]
            if close and job.fine:
                views += close_ups(job.fine[k], self._parts, body, seen)
            found.append(frame_loss(self._scene, body, views, silhouette, differentiated=True))
        return found


class SharedFrameLosses:
    """The same losses, computed by this process and by helpers once these have started."""

    def __init__(self, here: FrameLosses, pool: Executor, helpers: int) -> None:
        self._here, self._pool, self._processes = here, pool, helpers + 1
        self._starting = [pool.submit(_started) for _ in range(helpers)]

    def __call__(self, frames: Sequence[int], bodies: Tensor, close: bool) -> list[FrameLoss]:
        """Return what :class:`FrameLosses` returns."""
        if self._starting and all(future.done() for future in self._starting):
            self._starting = []
        if self._starting or len(frames) == 1:
            return self._here(frames, bodies, close)
        try:
            return self._shared(frames, bodies, close)
        except BrokenExecutor as error:
            raise worker_died(error) from None

    def _shared(self, frames: Sequence[int], bodies: Tensor, close: bool) -> list[FrameLoss]:
        own, *others = (slice(k, None, self._processes) for k in range(self._processes))
        futures = [
            self._pool.submit(_in_helper, frames[some], bodies[some].numpy(), close)
            for some in others
            if frames[some]
        ]
        found: list[FrameLoss | None] = [None] * len(frames)
        found[own] = self._here(frames[own], bodies[own], close)
        for some, future in zip(others, futures, strict=False):
            found[some] = [(loss, torch.from_numpy(grad)) for loss, grad in future.result()]
        return found


@contextmanager
def shared_losses(
    here: FrameLosses, processes: int, count: int
) -> Iterator[FrameLosses | SharedFrameLosses]:
    """Yield losses that so many processes share, this one included, if a job needs many.

    Args:
        here: the losses in this process.
        processes: at most so many.
        count: how many losses the job needs.
    """
    if processes == 1 or count < LEAST:
        yield here
        return
    with worker_processes(processes - 1, _start_helper, *here.given) as pool:
        yield SharedFrameLosses(here, pool, processes - 1)


_losses: FrameLosses | None = None  # of a helper


def _start_helper(job: RefineJob, silhouette: float, weights: Mapping[str, float]) -> None:
    global _losses
    torch.set_num_threads(1)
    dr.set_thread_count(1)
    _losses = FrameLosses(job, silhouette, weights)


def _started() -> None:
    """Answer once the helper has started."""


def _in_helper(
    frames: Sequence[int], bodies: np.ndarray, close: bool
) -> list[tuple[float, np.ndarray]]:
    found = _losses(frames, torch.from_numpy(bodies), close)
    return [(loss, grad.numpy()) for loss, grad in found]
