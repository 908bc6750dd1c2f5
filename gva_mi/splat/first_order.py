"""What is refused of torch's autograd, in a sentence: second derivatives, and batches it hides.

``FirstOrder`` stands before the tensors that an adjoint or a tangent is computed at. Without it
torch would take their second derivatives for zero wherever dL/dy is a constant.
"""

from __future__ import annotations

from typing import NoReturn

import torch
from torch import Tensor
from torch._C._functorch import is_legacy_batchedtensor
from torch.autograd.function import FunctionCtx


class FirstOrder(torch.autograd.Function):
    """Tensors as they are, which refuse to be differentiated."""

    generate_vmap_rule = True

    @staticmethod
    def forward(*tensors: Tensor | None) -> tuple[Tensor | None, ...]:
        return tuple(None if tensor is None else tensor.view_as(tensor) for tensor in tensors)

    @staticmethod
    def setup_context(ctx: FunctionCtx, inputs: tuple, output: tuple) -> None:
        ctx.set_materialize_grads(False)

    @staticmethod
    def backward(ctx: FunctionCtx, *grads: Tensor | None) -> NoReturn:
        raise RuntimeError(REFUSAL)

    @staticmethod
    def jvp(ctx: FunctionCtx, *tangents: Tensor | None) -> NoReturn:
        raise RuntimeError(REFUSAL)


REFUSAL = (
    "render(): its gradients and tangents cannot be differentiated again by the Gaussians, the "
    "background or the camera; second derivatives, as a Hessian or a penalty on a gradient needs "
    "them, are not available"
)


BATCHED = (
    "render(): it takes no gradients or tangents in batches, as is_grads_batched and "
    "functional.jacobian's vectorize make them; torch.func's jacrev, jacfwd and vmap work"
)


def refuse_batches(*tensors: Tensor | None) -> None:
    """Raise for batches of the vmap before torch.func's, which knows no autograd.Function."""
    if any(x is not None and is_legacy_batchedtensor(x) for x in tensors):
        raise RuntimeError(BATCHED)
