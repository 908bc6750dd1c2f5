"""Share memory between torch's tensors and Dr.Jit's arrays."""

from __future__ import annotations

import torch
from drjit import ArrayBase as Array
from drjit.llvm import Float, Float64
from torch import Tensor

ALIGNMENT = 64  # bytes; torch's own memory has it
PRECISION = {torch.float32: Float, torch.float64: Float64}


def to_drjit(tensor: Tensor, F: type) -> Array:
    """Return the tensor's own memory as a flat array; a copy if it is not aligned or contiguous."""
    tensor = tensor.detach().contiguous()
    if tensor.data_ptr() % ALIGNMENT:  # from numpy, or a slice
        tensor = tensor.clone()
    return F(tensor.view(-1))


def tensor_of(array: Array, count: int | None = None) -> Tensor:
    """Return an array's own memory as a tensor, (width,) or its first ``count`` numbers.

    It goes through numpy, because Dr.Jit's ``.torch()`` takes three times as long.
    """
    return torch.from_numpy(array.numpy()[:count])
