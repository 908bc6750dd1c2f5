"""The three passes as operations of torch's autograd and of torch.func.

With x everything that is differentiated and y the images,

    Render    x -> y               forward
    Adjoint   x, dL/dy -> dL/dx    backward of Render: linear in dL/dy
    Tangent   x, dx -> dy          jvp of Render: linear in dx

Adjoint and Tangent are each other's transpose, so each is the other's derivative by the argument
in which it is linear. Their derivatives by x would be second derivatives of the picture, which are
not implemented: ``FirstOrder`` stands before x and refuses them.
"""

from __future__ import annotations

from typing import Any, NoReturn

import torch
from torch import Tensor
from torch.autograd.function import FunctionCtx

from gva_mi.jit.exclusive import exclusive
from gva_mi.jit.not_compiled import not_compiled
from gva_mi.splat.torch_passes import (
    IMAGE_COUNT,
    Drawn,
    Images,
    Tensors,
    adjoint,
    draw,
    images,
    tangent,
)

NO_SECOND_DERIVATIVES = (
    "render(): its gradients and tangents cannot be differentiated again by the Gaussians, the "
    "background or the camera; second derivatives, as a Hessian or a penalty on a gradient needs "
    "them, are not available"
)


def one_by_one(function: type[torch.autograd.Function]) -> type[torch.autograd.Function]:
    """Give an operation its vmap: call it for each element of a batch and stack the results.

    Where only gradients or tangents are batched, as a Jacobian's rows are, all elements belong to
    the same picture.
    """

    def vmap(info: Any, dims: tuple, *arguments: Any) -> tuple[tuple, tuple]:  # noqa: ANN401
        same_picture = all(dim is None for dim in dims[: len(Tensors._fields)])

        def element(value: Any, dim: int | None, k: int) -> Any:  # noqa: ANN401
            if isinstance(value, Drawn) and not same_picture:
                return value.elements[k]
            return value if dim is None else value.select(dim, k)

        results = [
            function.apply(*(element(v, dim, k) for v, dim in zip(arguments, dims, strict=True)))
            for k in range(info.batch_size)
        ]
        stacked = tuple(_stacked(column) for column in zip(*results, strict=True))
        return stacked, tuple(0 if isinstance(x, Tensor) else None for x in stacked)

    function.vmap = staticmethod(vmap)
    return function


def _stacked(column: tuple) -> Any:  # noqa: ANN401
    first = column[0]
    if isinstance(first, Drawn):
        return Drawn(first.call, elements=column)
    return None if first is None else torch.stack(column)


@one_by_one
class Render(torch.autograd.Function):
    """Forward pass: from ``Tensors`` and a ``RenderCall`` to color, alpha, depth and ``Drawn``.

    A ``Drawn`` in the place of the call is not drawn again (gsplat/means2d.py).
    """

    @staticmethod
    @exclusive
    def forward(*arguments: Any) -> tuple:  # noqa: ANN401
        *tensors, call = arguments
        drawn = call if isinstance(call, Drawn) else draw(call, Tensors(*tensors))
        return *images(drawn.saved.planes, drawn.saved), drawn

    @staticmethod
    def setup_context(ctx: FunctionCtx, inputs: tuple, output: tuple) -> None:
        ctx.drawn = output[-1]
        # the kernels read the tensors' memory again: torch raises if it was overwritten
        ctx.save_for_backward(*inputs[:-1])
        ctx.save_for_forward(*inputs[:-1])
        ctx.set_materialize_grads(False)

    @staticmethod
    @not_compiled
    def backward(ctx: FunctionCtx, *grads: Tensor | None) -> tuple[Tensor | None, ...]:
        tensors, drawn = ctx.saved_tensors, ctx.drawn
        requested = drawn.call.requested(Tensors(*ctx.needs_input_grad[:-1]))
        by_images = _three(grads[:-1])
        if not torch.is_grad_enabled():
            return *adjoint(Tensors(*tensors), by_images, drawn, requested), None
        return *Adjoint.apply(*FirstOrder.apply(*tensors), *by_images, drawn, requested), None

    @staticmethod
    @not_compiled
    def jvp(ctx: FunctionCtx, *tangents: Tensor | None) -> tuple:
        tensors = FirstOrder.apply(*ctx.saved_tensors)
        return *Tangent.apply(*tensors, *tangents[:-1], ctx.drawn), None


@one_by_one
class Adjoint(torch.autograd.Function):
    """Backward pass: from ``Tensors``, image gradients, ``Drawn`` and a request to gradients."""

    @staticmethod
    def forward(*arguments: Any) -> tuple[Tensor | None, ...]:  # noqa: ANN401
        *values, drawn, requested = arguments
        tensors, grads = Tensors(*values[:-IMAGE_COUNT]), tuple(values[-IMAGE_COUNT:])
        return tuple(adjoint(tensors, grads, drawn, requested))

    @staticmethod
    def setup_context(ctx: FunctionCtx, inputs: tuple, output: tuple) -> None:
        *values, ctx.drawn, ctx.requested = inputs
        ctx.given = [grad is not None for grad in values[-IMAGE_COUNT:]]
        ctx.save_for_backward(*values[:-IMAGE_COUNT])
        ctx.save_for_forward(*values[:-IMAGE_COUNT])
        ctx.set_materialize_grads(False)

    @staticmethod
    def backward(ctx: FunctionCtx, *tangents: Tensor | None) -> tuple[Tensor | None, ...]:
        images = _three(Tangent.apply(*ctx.saved_tensors, *tangents, ctx.drawn))
        by_grads = [x if given else None for x, given in zip(images, ctx.given, strict=True)]
        return *[None] * len(tangents), *by_grads, None, None

    @staticmethod
    def jvp(ctx: FunctionCtx, *tangents: Tensor | None) -> tuple[Tensor | None, ...]:
        *_, color, alpha, depth, _, _ = tangents
        return Adjoint.apply(*ctx.saved_tensors, color, alpha, depth, ctx.drawn, ctx.requested)


@one_by_one
class Tangent(torch.autograd.Function):
    """Tangent pass: from ``Tensors``, their tangents and ``Drawn`` to the images' tangents."""

    @staticmethod
    def forward(*arguments: Any) -> Images:  # noqa: ANN401
        *values, drawn = arguments
        return tangent(Tensors(*values[len(Tensors._fields) :]), drawn)

    @staticmethod
    def setup_context(ctx: FunctionCtx, inputs: tuple, output: Images) -> None:
        *values, ctx.drawn = inputs
        tensors, tangents = values[: len(Tensors._fields)], values[len(Tensors._fields) :]
        ctx.given = [tangent is not None for tangent in tangents]
        ctx.save_for_backward(*tensors)
        ctx.save_for_forward(*tensors)
        ctx.set_materialize_grads(False)

    @staticmethod
    def backward(ctx: FunctionCtx, *grads: Tensor | None) -> tuple[Tensor | None, ...]:
        requested = ctx.drawn.call.requested(Tensors(*ctx.given))
        found = Adjoint.apply(*ctx.saved_tensors, *_three(grads), ctx.drawn, requested)
        by_tangents = [x if given else None for x, given in zip(found, ctx.given, strict=True)]
        return *[None] * len(found), *by_tangents, None

    @staticmethod
    def jvp(ctx: FunctionCtx, *tangents: Tensor | None) -> Images:
        return Tangent.apply(*ctx.saved_tensors, *tangents[len(Tensors._fields) : -1], ctx.drawn)


class FirstOrder(torch.autograd.Function):
    """Pass tensors on, and refuse to be differentiated.

    Without it torch would take second derivatives for zero wherever dL/dy is a constant.
    """

    generate_vmap_rule = True

    @staticmethod
    def forward(*tensors: Tensor | None) -> tuple[Tensor | None, ...]:
        return tuple(None if tensor is None else tensor.view_as(tensor) for tensor in tensors)

    @staticmethod
    def setup_context(ctx: FunctionCtx, inputs: tuple, output: tuple) -> None:
        ctx.set_materialize_grads(False)

    @staticmethod
    def backward(ctx: FunctionCtx, *grads: Tensor | None) -> NoReturn:
        raise RuntimeError(NO_SECOND_DERIVATIVES)

    @staticmethod
    def jvp(ctx: FunctionCtx, *tangents: Tensor | None) -> NoReturn:
        raise RuntimeError(NO_SECOND_DERIVATIVES)


def _three(images: tuple) -> Images:
    """Append None for a depth that is not made."""
    return *images, *[None] * (IMAGE_COUNT - len(images))
