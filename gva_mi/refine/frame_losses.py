"""The data term of a step's frames, with its gradient.

The loss of a frame and its gradient are many small kernels, which gain little from a second thread
(:func:`gva_mi.core.cpu.one_thread`). So processes share the frames of a step
(:class:`gva_mi.core.tasks.Helpers`), each on one thread. Every frame is computed by itself, so any
number of processes finds the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx

from gva_mi.body.smplx import BodyModel
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.refine.close_ups import FinePicture, WeightedView, close_ups, parts_of
from gva_mi.refine.image_evidence import MaskAndNormals


class FrameLoss(NamedTuple):
    """Loss of a frame, and its gradient with respect to the body (V, 3), None if not needed."""

    loss: float
    gradient: np.ndarray | None


class FrameBody(NamedTuple):
    """The body in a frame."""

    frame: int
    vertices: np.ndarray  # (V, 3) world, metres
    close: bool  # whether close-ups count, if there are any


def with_gradient(
    compute: Callable[[bool], tuple[Tensor, list[Tensor]]], *inputs: Tensor
) -> Tensor:
    """Return a scalar that is computed together with its gradients, for autograd.

    Args:
        compute: returns the scalar, and gradients with respect to the inputs if it is called with
            True.
        inputs: that the scalar depends on.
    """
    return _WithGradient.apply(compute, *inputs)


class _WithGradient(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: FunctionCtx, compute: Callable[[bool], tuple[Tensor, list[Tensor]]], *inputs: Tensor
    ) -> Tensor:
        value, gradients = compute(any(ctx.needs_input_grad))
        ctx.save_for_backward(*gradients)
        return value

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: FunctionCtx, grad: Tensor) -> tuple[Tensor | None, ...]:
        return None, *(grad * gradient for gradient in ctx.saved_tensors)


def mean_of_losses(vertices: Tensor, losses: Callable[[np.ndarray], list[FrameLoss]]) -> Tensor:
    """Return the mean of frames' losses, differentiable in the vertices (B, V, 3).

    ``losses`` computes them from plain vertices, with gradients.
    """

    def mean(differentiated: bool) -> tuple[Tensor, list[Tensor]]:
        found, gradients = zip(*losses(vertices.detach().numpy()), strict=True)
        gradient = torch.from_numpy(np.stack(gradients)) / len(found)
        return vertices.new_tensor(sum(found) / len(found)), [gradient]

    return with_gradient(mean, vertices)


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
    return FrameLoss(float(loss.detach()), None if gradient is None else gradient.numpy())


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
        self._evidence, self._fine, self._silhouette = evidence, fine, silhouette
        self._scene = MeshScene(body.faces, body.v_template)
        self._parts = {part: w for part in parts_of(body) if (w := weights[part.name]) > 0}

    def __call__(self, bodies: Sequence[FrameBody]) -> list[FrameLoss]:
        """Return the losses of some frames, with gradients."""
        losses, fine, silhouette = [], self._fine, self._silhouette
        for k, vertices, close in bodies:
            body, seen = torch.from_numpy(vertices), self._evidence[k]
            closer = close_ups(fine[k], self._parts, body, seen) if close and fine else []
            views = [WeightedView(1.0, seen), *closer]
            losses.append(frame_loss(self._scene, body, views, silhouette, differentiated=True))
        return losses
