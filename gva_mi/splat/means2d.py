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

import weakref
from collections.abc import Callable, Sequence
from typing import Any

import torch
from torch import Tensor
from torch._C._functorch import is_functorch_wrapped_tensor
from torch.autograd import Variable
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
        means2d, depths = call.screen.means2d_of(call.rows), call.pick(call.screen.depths)
        return means2d, depths, _nothing(means2d)

    @staticmethod
    def setup_context(ctx: FunctionCtx, inputs: tuple, output: Values) -> None:
        ctx.call, ctx.others = inputs[-1], len(inputs) - 3
        ctx.save_for_backward(*inputs[:3])
        ctx.save_for_forward(*inputs[:3])
        ctx.set_materialize_grads(False)

    @staticmethod
    @not_compiled
    def backward(
        ctx: FunctionCtx, grad: Tensor | None, by_depths: Tensor | None, known: Tensor | None
    ) -> Values:
        if ctx.call.copied is not None:
            ctx.call.copied()
        found: Values = (None, None, None)
        if by_depths is not None or known is None or not _one_memory(grad, known):
            found = _pulled(ctx, grad, by_depths, known)
        return *found, *[None] * ctx.others

    @staticmethod
    @not_compiled
    def jvp(ctx: FunctionCtx, *tangents: Tensor | None) -> Values:
        images, pull = vjp(_projection(ctx.call), *ctx.saved_tensors)
        zeros = _filled((None, None), images)
        _, push = vjp(pull, zeros)  # pull is linear: its own transpose is the tangent
        (found,) = push(_filled(tangents[:3], ctx.saved_tensors))
        return *found, _nothing(found[0])

    @staticmethod
    def vmap(info: Any, dims: tuple, *arguments: Any) -> tuple[tuple, tuple]:  # noqa: ANN401
        return one_by_one(ProjectMeans, info, dims, arguments)


def keep_on_one_thread(means2d: Tensor, calls: Sequence[Call]) -> None:
    """Have one thread make the copy of its gradient that ``retain_grad`` keeps.

    Each pass ends torch's threads (threads.py). For this one copy they would be started anew, and
    would spin on the cores until the next pass: that took longer than the copy, and than the rest
    of what gsplat's call costs beside ``render``.

    Args:
        means2d: of all pictures.
        calls: of the pictures: their ``ProjectMeans`` comes next on the way back.
    """
    if not means2d.requires_grad or is_functorch_wrapped_tensor(means2d):
        return
    # its own graph holds the hooks: they must not hold the tensor
    node, held = weakref.ref(means2d), None

    def enter(_: Tensor) -> None:
        nonlocal held
        target, threads = node(), torch.get_num_threads()
        if threads > 1 and target is not None and target.retains_grad:
            one = _OneThread(threads)
            held = weakref.ref(one)
            Variable._execution_engine.queue_callback(one.leave)

    def leave() -> None:
        one = held and held()
        if one is not None:
            one.leave()

    means2d.register_hook(enter)
    for call in calls:
        call.copied = leave


class _OneThread:
    """One thread of torch's until somebody leaves, or nobody is left who would.

    The engine of the backward pass holds it: a hook of the caller's may raise, or the pass may end
    at ``means2d``.
    """

    def __init__(self, before: int) -> None:
        self.before = before
        torch.set_num_threads(1)

    def leave(self) -> None:
        """Restore their number."""
        if self.before > 1:
            torch.set_num_threads(self.before)
            self.before = 1

    __del__ = leave


@exclusive
@one_torch_thread()
def _pulled(
    ctx: FunctionCtx, grad: Tensor | None, by_depths: Tensor | None, known: Tensor | None
) -> Values:
    """The gradients by means, T_camera_world, K of what the kernels do not know."""
    if known is not None:
        grad = None if _same(grad, known) else grad - known
    if grad is None and by_depths is None:
        return None, None, None
    images, pull = vjp(_projection(ctx.call), *ctx.saved_tensors)
    return pull(_filled((grad, by_depths), images))


def _same(grad: Tensor, known: Tensor) -> bool:
    """Whether two gradients are equal.

    torch.func's tensors are no plain numbers: they get the difference, of zeros.
    """
    if is_functorch_wrapped_tensor(grad):
        return False
    return _one_memory(grad, known) or torch.equal(grad, known)


def _one_memory(grad: Tensor, known: Tensor) -> bool:
    """Whether two gradients are one tensor, told twice: mostly they are."""
    if is_functorch_wrapped_tensor(grad):
        return False
    return grad.data_ptr() == known.data_ptr() and grad.stride() == known.stride()


def _nothing(like: Tensor) -> Tensor:
    """Zeros of its shape, a single number in memory: nobody reads them, but for their gradient."""
    return like.new_zeros(()).expand_as(like)


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
