"""The data term of a step's frames, with its gradient, shared among processes.

The loss of a frame and its gradient are many small kernels, which gain little from a second thread
(:func:`gva_mi.core.cpu.one_thread`). So each process has one thread and takes whole frames. Every
frame is computed by itself, so any number of processes finds the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx

from gva_mi.body.smplx import BodyModel
from gva_mi.core.tasks import worker_died, worker_processes
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.refine.close_ups import FinePicture, WeightedView, close_ups, parts_of
from gva_mi.refine.image_evidence import MaskAndNormals

# Losses of a clip from which helper processes pay; they take 4 s to start. Chosen by eye.
SHARED_LOSSES = 1000


class FrameLoss(NamedTuple):
    """Loss of a frame, and its gradient with respect to the body (V, 3), None if not needed."""

    loss: float
    gradient: Tensor | None


def mean_of_losses(vertices: Tensor, losses: Callable[[Tensor], list[FrameLoss]]) -> Tensor:
    """Return the mean of frames' losses, differentiable in the vertices (B, V, 3).

    ``losses`` computes them from detached vertices, with gradients if these are needed.
    """
    return _MeanLoss.apply(vertices, losses)


def frame_loss(
    scene: MeshScene,
    body: Tensor,
    views: Sequence[WeightedView],
    silhouette: float,
    differentiated: bool,
) -> FrameLoss:
    """Return the weighted sum of the views' losses, and its gradient with respect to the body.

    The gradient is computed with the loss, while the scene shows the body: to move the mesh a
    second time would cost as much as a rendering. For the same reason all views are rendered
    together.

    Args:
        scene: in which the body is rendered.
        body: (V, 3) world, metres.
        views: the whole person, then close-ups.
        silhouette: λ1.
        differentiated: whether the gradient (V, 3) is needed; otherwise it is None.
    """
    (weight, person), *closer = views
    picture, views = person.camera, [WeightedView(weight, person.around(body.detach())), *closer]
    with torch.set_grad_enabled(differentiated):
        body = body.detach().contiguous().requires_grad_(differentiated)
        normals = any(seen.normals is not None for _, seen in views)
        images = scene.render_crops(body, picture, [seen.camera for _, seen in views], normals)
        loss = sum(
            weight * seen.loss(image, silhouette)
            for (weight, seen), image in zip(views, images, strict=True)
        )
        gradient = torch.autograd.grad(loss, body)[0] if differentiated else None
    return FrameLoss(float(loss.detach()), gradient)


class _MeanLoss(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: FunctionCtx, vertices: Tensor, losses: Callable[[Tensor], list[FrameLoss]]
    ) -> Tensor:
        found, gradients = zip(*losses(vertices.detach()), strict=True)
        if ctx.needs_input_grad[0]:
            ctx.save_for_backward(torch.stack(gradients) / len(found))
        return vertices.new_tensor(sum(found) / len(found))

    @staticmethod
    def backward(ctx: FunctionCtx, grad_loss: Tensor) -> tuple[Tensor, None]:
        (gradient,) = ctx.saved_tensors
        return grad_loss * gradient, None


class FrameLosses:
    """Losses of frames, computed in this process."""

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
            evidence: by frame.
            fine: pictures for close-ups, by frame; empty: no close-ups.
            silhouette: λ1.
            weights: λc of the close-ups, by the name of the part.
        """
        self.given = body, evidence, fine, silhouette, weights  # for helper processes
        self._evidence, self._fine, self._silhouette = evidence, fine, silhouette
        self._scene = MeshScene(body.faces, body.v_template)
        self._parts = {part: w for part in parts_of(body) if (w := weights[part.name]) > 0}

    def __call__(self, frames: Sequence[int], bodies: Tensor, close: bool) -> list[FrameLoss]:
        """Return the losses of B frames, with gradients with respect to bodies (B, V, 3), world, m.

        ``close`` says whether close-ups count, if there are any.
        """
        losses, fine, silhouette = [], self._fine, self._silhouette
        for k, body in zip(frames, bodies.unbind(), strict=True):
            seen = self._evidence[k]
            closer = close_ups(fine[k], self._parts, body, seen) if close and fine else []
            views = [WeightedView(1.0, seen), *closer]
            losses.append(frame_loss(self._scene, body, views, silhouette, differentiated=True))
        return losses


class SharedFrameLosses:
    """Losses of frames, shared by this process and, once they have started, helper processes."""

    def __init__(self, here: FrameLosses, pool: Executor, helpers: int) -> None:
        self._here, self._pool, self._processes = here, pool, helpers + 1
        self._starting = [pool.submit(_started) for _ in range(helpers)]

    def __call__(self, frames: Sequence[int], bodies: Tensor, close: bool) -> list[FrameLoss]:
        """Return what :class:`FrameLosses` returns."""
        if self._starting and all(future.done() for future in self._starting):
            self._starting = []
        if self._starting or len(frames) == 1:
            return self._here(frames, bodies, close)
        here, *others = (slice(k, None, self._processes) for k in range(self._processes))
        found: list[FrameLoss | None] = [None] * len(frames)
        try:
            futures = [
                self._pool.submit(_in_helper, frames[share], bodies[share].numpy(), close)
                for share in others
                if frames[share]
            ]
            found[here] = self._here(frames[here], bodies[here], close)
            for share, future in zip(others, futures, strict=False):
                found[share] = [FrameLoss(x, torch.from_numpy(grad)) for x, grad in future.result()]
        except BrokenExecutor as error:
            raise worker_died(error) from None
        return found


@contextmanager
def shared_losses(
    here: FrameLosses, processes: int, count: int
) -> Iterator[FrameLosses | SharedFrameLosses]:
    """Yield losses that processes share, this one included; if a clip needs few, ``here`` alone.

    Args:
        here: the losses in this process.
        processes: largest number of them.
        count: number of losses that the clip needs.
    """
    if processes == 1 or count < SHARED_LOSSES:
        yield here
        return
    with worker_processes(processes - 1, _start_helper, *here.given) as pool:
        yield SharedFrameLosses(here, pool, processes - 1)


_losses: FrameLosses | None = None  # of a helper process


def _start_helper(*given: object) -> None:
    import drjit as dr

    global _losses
    torch.set_num_threads(1)
    dr.set_thread_count(1)
    _losses = FrameLosses(*given)


def _started() -> None:
    """Return once the helper has started."""


def _in_helper(
    frames: Sequence[int], bodies: np.ndarray, close: bool
) -> list[tuple[float, np.ndarray]]:
    found = _losses(frames, torch.from_numpy(bodies), close)
    return [(loss, grad.numpy()) for loss, grad in found]
