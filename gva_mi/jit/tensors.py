"""Share memory between torch's tensors and Dr.Jit's arrays, out of sight of ``torch.compile``."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import torch
from drjit import ArrayBase as Array
from drjit.llvm import Float, Float64
from torch import Tensor

ALIGNMENT = 64  # bytes of a cache line and of an AVX-512 vector; torch's own memory has it
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


P = ParamSpec("P")
R = TypeVar("R")


def not_compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Exclude a function from ``torch.compile``, which cannot trace Dr.Jit's kernels.

    ``torch.compiler.disable`` imports the compiler, which takes as long as importing torch. So it
    is called only if the program has imported the compiler.
    """
    excluded = None

    @functools.wraps(function)
    def call(*arguments: P.args, **options: P.kwargs) -> R:
        nonlocal excluded
        if "torch._dynamo" not in sys.modules:
            return function(*arguments, **options)
        if excluded is None:
            excluded = torch.compiler.disable(function)
        return excluded(*arguments, **options)

    return call
