"""The data term of a step's frames, shared among processes.

A frame's loss and its gradient are many small kernels, which gain little from a second thread
(:func:`gva_mi.core.cpu.one_thread`). So processes with one thread each take a frame each. Every
frame is computed by itself, so any number of processes finds the same bits.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor
from contextlib import contextmanager

import numpy as np
import torch
from torch import Tensor

from gva_mi.body.smplx import BodyModel
from gva_mi.core.tasks import worker_died, worker_processes
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.refine.evidence import (
    FinePicture,
    FrameLoss,
    MaskAndNormals,
    close_ups,
    frame_loss,
    parts_of,
)

ENOUGH_LOSSES = 1000  # of a clip: from so many on, helper processes, which take 4 s to start, pay


class FrameLosses:
    """Losses of frames by the vertices of the body, computed in this process."""

    def __init__(
        self,
        body: BodyModel,
        evidence: Mapping[int, MaskAndNormals],
        fine: Mapping[int, FinePicture],
        silhouette: float,
        weights: Mapping[str, float],
    ) -> None:
        """Prepare the scene.

        Args:
            body: that is compared with the evidence.
            evidence, fine: by frame; ``fine`` for close-ups, empty where there are none.
            silhouette: λ1.
            weights: λc of the close-ups, by the names of the parts.
        """
        self.given = body, evidence, fine, silhouette, weights
        self._scene = MeshScene(body.faces, body.v_template)
        self._parts = {part: w for part in parts_of(body) if (w := weights[part.name]) > 0}

    def __call__(self, frames: Sequence[int], bodies: Tensor, close: bool) -> list[FrameLoss]:
        """Return the loss of each of B frames, and its gradient by the body (B, V, 3), metres.

        ``close`` says whether close-ups count, where there are some.
        """
        (_, evidence, fine, silhouette, _), found = self.given, []
        for k, body in zip(frames, bodies.unbind(), strict=True):
            seen = evidence[k]
            closer = close_ups(fine[k], self._parts, body, seen) if close and fine else []
            views = [(1.0, seen), *closer]
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
        own, *others = (slice(k, None, self._processes) for k in range(self._processes))
        found: list[FrameLoss | None] = [None] * len(frames)
        try:
            futures = [
                self._pool.submit(_in_helper, frames[some], bodies[some].numpy(), close)
                for some in others
                if frames[some]
            ]
            found[own] = self._here(frames[own], bodies[own], close)
            for some, future in zip(others, futures, strict=False):
                found[some] = [(loss, torch.from_numpy(grad)) for loss, grad in future.result()]
        except BrokenExecutor as error:
            raise worker_died(error) from None
        return found


@contextmanager
def shared_losses(
    here: FrameLosses, processes: int, count: int
) -> Iterator[FrameLosses | SharedFrameLosses]:
    """Yield losses that so many processes share, this one included, if a clip needs many.

    Args:
        here: the losses in this process.
        processes: at most so many.
        count: how many losses the clip needs.
    """
    if processes == 1 or count < ENOUGH_LOSSES:
        yield here
        return
    with worker_processes(processes - 1, _start_helper, *here.given) as pool:
        yield SharedFrameLosses(here, pool, processes - 1)


_losses: FrameLosses | None = None  # of a helper


def _start_helper(*given: object) -> None:
    import drjit as dr

    global _losses
    torch.set_num_threads(1)
    dr.set_thread_count(1)
    _losses = FrameLosses(*given)


def _started() -> None:
    """Answer once the helper has started."""


def _in_helper(
    frames: Sequence[int], bodies: np.ndarray, close: bool
) -> list[tuple[float, np.ndarray]]:
    found = _losses(frames, torch.from_numpy(bodies), close)
    return [(loss, grad.numpy()) for loss, grad in found]
