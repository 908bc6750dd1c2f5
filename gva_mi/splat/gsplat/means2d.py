"""``meta["means2d"]`` as a node of torch's graph: its gradient can be kept, hooked and added to.

gsplat's users call ``meta["means2d"].retain_grad()`` before backward, register hooks on it, and put
losses on it. Therefore it lies between the means and the images:

    means, T_camera_world, K            -> ProjectMeans -> means2d, depths, echo, drawn
    means2d, echo, and all the tensors  -> Render       -> images

The kernels run once, in ProjectMeans. In backward they propagate the images' gradient to the means
and the camera themselves, and also give ``means2d`` its share. To count that share only once,
``echo`` receives it too: ProjectMeans propagates only the difference between the two, which hooks
and other losses caused.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx
from torch.func import vjp

from gva_mi.core.cpu import quiet_openmp, sqrt
from gva_mi.jit.exclusive import exclusive
from gva_mi.jit.not_compiled import not_compiled
from gva_mi.splat.autograd import one_by_one
from gva_mi.splat.torch_passes import Drawn, Tensors, draw

ON_AXIS = 1e-6  # below this (r / z)^2 a fisheye's s is the start of its series

Values = tuple[Tensor | None, ...]


@one_by_one
class ProjectMeans(torch.autograd.Function):
    """Autograd node from means and camera to means2d, depths, echo and the ``Drawn`` picture.

    Its inputs are means, T_camera_world, K, an anchor, six other tensors and a ``RenderCall``.

    The others, quats to background, are detached: they get their gradients from ``Render``. The
    anchor is one of them that needs a gradient, so that ``means2d`` has a gradient where means and
    camera are frozen; None if there is none.
    """

    @staticmethod
    @exclusive
    def forward(*arguments: Any) -> tuple:  # noqa: ANN401
        means, T_camera_world, K, _, *others, call = arguments
        drawn = draw(call, Tensors(means, *others, T_camera_world, K, None, None))
        means2d, depths = call.screen.means2d_of(drawn.rows), drawn.pick(call.screen.depths)
        return means2d, depths, _zeros(means2d), drawn

    @staticmethod
    def setup_context(ctx: FunctionCtx, inputs: tuple, output: tuple) -> None:
        ctx.drawn, ctx.others = output[-1], len(inputs) - 3
        ctx.save_for_backward(*inputs[:3])
        ctx.save_for_forward(*inputs[:3])
        ctx.set_materialize_grads(False)

    @staticmethod
    @not_compiled
    @exclusive
    @quiet_openmp()  # retain_grad has just copied a gradient, on all threads
    def backward(
        ctx: FunctionCtx,
        grad: Tensor | None,
        by_depths: Tensor | None,
        echo: Tensor | None,
        _: None,
    ) -> Values:
        if echo is not None:
            grad = None if _equal(grad, echo) else grad - echo
        found: Values = (None, None, None)
        if grad is not None or by_depths is not None:
            images, pull = vjp(_projection(ctx.drawn), *ctx.saved_tensors)
            found = pull(_filled((grad, by_depths), images))
        return *found, *[None] * ctx.others

    @staticmethod
    @not_compiled
    def jvp(ctx: FunctionCtx, *tangents: Tensor | None) -> tuple:
        images, pull = vjp(_projection(ctx.drawn), *ctx.saved_tensors)
        zeros = _filled((None, None), images)
        _, push = vjp(pull, zeros)  # pull is linear: its own transpose is the tangent
        (found,) = push(_filled(tangents[:3], ctx.saved_tensors))
        return *found, _zeros(found[0]), None


def _equal(grad: Tensor, echo: Tensor) -> bool:
    """Whether two gradients are equal; mostly they are the same memory.

    torch.func's wrapped tensors have no memory of their own and raise. They count as unlike: their
    difference is zero anyway.
    """
    try:
        same = grad.data_ptr() == echo.data_ptr() and grad.stride() == echo.stride()
        return same or torch.equal(grad, echo)
    except RuntimeError:
        return False


def _zeros(like: Tensor) -> Tensor:
    """Return zeros of the same shape, a single number in memory: only their gradient is used."""
    return like.new_zeros(()).expand_as(like)


def _filled(given: Values, like: Values) -> tuple[Tensor, ...]:
    """Replace None by zeros."""
    pairs = zip(given, like, strict=True)
    return tuple(torch.zeros_like(model) if x is None else x for x, model in pairs)


def _projection(drawn: Drawn) -> Callable[[Tensor, Tensor, Tensor], tuple[Tensor, Tensor]]:
    """Eq. 1 and 2 (lens.py) in torch: means, T_camera_world, K to means2d, depths.

    The result is meaningless where a Gaussian is not drawn. Products are written as sums, because
    the last bits of a matrix product depend on the number of threads.
    """
    model, near = drawn.call.camera.model, drawn.call.options.near

    def project(means: Tensor, T_camera_world: Tensor, K: Tensor) -> tuple[Tensor, Tensor]:
        means = drawn.pick(means)
        x = (means[:, None, :] * T_camera_world[:3, :3]).sum(dim=-1) + T_camera_world[:3, 3]
        depths, f, c = x[:, 2], torch.diagonal(K)[:2], K[:2, 2]
        # One on the near plane is drawn, whatever the last digit of its depth.
        z = torch.where(depths > 0.5 * near, depths, 1)[:, None]
        if model == "pinhole":
            return f * x[:, :2] / z + c, depths
        if model == "ortho":
            return f * x[:, :2] + c, depths
        squared = x[:, :2].square().sum(dim=-1, keepdim=True)
        on_axis = squared < ON_AXIS * z * z
        r = sqrt(torch.where(on_axis, 1, squared))
        s = torch.where(on_axis, (1 - squared / (3 * z * z)) / z, torch.atan2(r, z) / r)
        return f * x[:, :2] * s + c, depths

    return project
