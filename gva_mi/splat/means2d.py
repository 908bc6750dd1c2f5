"""The means in the picture as a node of torch's graph: their gradient can be kept, and used.

gsplat's users call ``meta["means2d"].retain_grad()`` before backward, hang hooks on it, and put
losses on it. So it has to lie between the means and the images:

    means, T_camera_world, K            -> ProjectMeans -> means2d, depths, known
    means2d, known, and all the tensors -> Render       -> images

The numbers are those of the kernels, which run in the first of the two. On the way back the kernels
carry the images' gradient on to the means and the camera by themselves, and tell ``means2d`` what
its share of it was. That this is not counted twice, ``known`` is told the same: where the two
arrive here unlike, something was added on the way, and the difference alone is carried on.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor
from torch._C._functorch import is_functorch_wrapped_tensor
from torch.autograd.function import FunctionCtx
from torch.func import vjp

from gva_mi.splat.autograd import Call, Tensors, draw, not_compiled, one_by_one, signed
from gva_mi.splat.kernels.exclusive import exclusive
from gva_mi.threads import one_torch_thread

ON_AXIS = 1e-6  # (r / z)^2 up to which a fisheye's s is the start of its series

Values = tuple[Tensor | None, ...]


class ProjectMeans(torch.autograd.Function):
    """means, T_camera_world, K, an anchor, five other tensors, a ``Call``; returns as above.

    The anchor is one of the others that wants a gradient, so that ``means2d`` has one where means
    and camera are frozen; None if there is none. The others, quats to background, are detached:
    they get their gradients from ``Render``.
    """

    @staticmethod
    @signed
    @exclusive
    def forward(*arguments: Any) -> Values:  # noqa: ANN401
        means, T_camera_world, K, _, *others, call = arguments
        draw(call, Tensors(means, *others, T_camera_world, K, None, None))
        means2d, depths = (call.pick(x) for x in (call.screen.means2d, call.screen.depths))
        return means2d, depths, torch.zeros_like(means2d)

    @staticmethod
    def setup_context(ctx: FunctionCtx, inputs: tuple, output: Values) -> None:
        ctx.call, ctx.others = inputs[-1], len(inputs) - 3
        ctx.save_for_backward(*inputs[:3])
        ctx.save_for_forward(*inputs[:3])
        ctx.set_materialize_grads(False)

    @staticmethod
    @not_compiled
    @exclusive
    @one_torch_thread()
    def backward(
        ctx: FunctionCtx, grad: Tensor | None, by_depths: Tensor | None, known: Tensor | None
    ) -> Values:
        if known is not None:
            grad = None if _same(grad, known) else grad - known
        found: Values = (None, None, None)
        if grad is not None or by_depths is not None:
            images, pull = vjp(_projection(ctx.call), *ctx.saved_tensors)
            found = pull(_filled((grad, by_depths), images))
        return *found, *[None] * ctx.others

    @staticmethod
    @not_compiled
    def jvp(ctx: FunctionCtx, *tangents: Tensor | None) -> Values:
        images, pull = vjp(_projection(ctx.call), *ctx.saved_tensors)
        zeros = _filled((None, None), images)
        _, push = vjp(pull, zeros)  # pull is linear: its own transpose is the tangent
        (found,) = push(_filled(tangents[:3], ctx.saved_tensors))
        return *found, torch.zeros_like(found[0])

    @staticmethod
    def vmap(info: Any, dims: tuple, *arguments: Any) -> tuple[tuple, tuple]:  # noqa: ANN401
        return one_by_one(ProjectMeans, info, dims, arguments)


def _same(grad: Tensor, known: Tensor) -> bool:
    """Whether two gradients are equal: mostly one tensor, told twice.

    torch.func's tensors are no plain numbers: they get the difference, of zeros.
    """
    if is_functorch_wrapped_tensor(grad):
        return False
    one = grad.data_ptr() == known.data_ptr() and grad.stride() == known.stride()
    return one or torch.equal(grad, known)


def _filled(given: Values, like: Values) -> tuple[Tensor, ...]:
    """Zeros where nothing is given."""
    pairs = zip(given, like, strict=True)
    return tuple(torch.zeros_like(model) if x is None else x for x, model in pairs)


def _projection(call: Call) -> Callable[[Tensor, Tensor, Tensor], tuple[Tensor, Tensor]]:
    """Eq. 1 and 2 (lens.py) as torch sees them: means, T_camera_world, K to means2d, depths.

    The means are meaningless where a Gaussian is not drawn. Products are written as sums, for the
    last bits of a matrix product depend on the number of threads.
    """
    model, near = call.camera.model, call.options.near

    def project(means: Tensor, T_camera_world: Tensor, K: Tensor) -> tuple[Tensor, Tensor]:
        means = call.pick(means)
        x = (means[:, None, :] * T_camera_world[:3, :3]).sum(dim=-1) + T_camera_world[:3, 3]
        depths, f, c = x[:, 2], torch.diagonal(K)[:2], K[:2, 2]
        z = torch.where(depths > near, depths, 1)[:, None]
        if model == "pinhole":
            return f * x[:, :2] / z + c, depths
        if model == "ortho":
            return f * x[:, :2] + c, depths
        squared = x[:, :2].square().sum(dim=-1, keepdim=True)
        on_axis = squared < ON_AXIS * z * z
        r = torch.where(on_axis, 1, squared).sqrt()
        s = torch.where(on_axis, (1 - squared / (3 * z * z)) / z, torch.atan2(r, z) / r)
        return f * x[:, :2] * s + c, depths

    return project
