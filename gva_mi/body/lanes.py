"""Dr.Jit kernels over the rows of torch tensors: a lane for each row."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import drjit as dr
import torch
from torch import Tensor

FLOATS = {torch.float32: dr.llvm.Float32, torch.float64: dr.llvm.Float64}


def launch(kernel: Callable, *tensors: Tensor) -> tuple[Tensor, ...]:
    """Run a kernel over the rows of tensors, without copies of those that are contiguous.

    Args:
        kernel: takes the K columns of each tensor as a list of Dr.Jit arrays, and returns such
            lists.
        tensors: (N, K), or (1, K) where all lanes read the same row; of one dtype out of
            :data:`FLOATS`. The first has N rows.

    Returns:
        A tensor (N, K') for each list.
    """
    Float = FLOATS[tensors[0].dtype]
    n = len(tensors[0])
    lane = dr.arange(dr.uint32_array_t(Float), n)
    columns = []
    for tensor in tensors:
        numbers, width = flat(tensor), tensor.shape[1]
        row = lane if len(tensor) == n else dr.zeros(dr.uint32_array_t(Float), n)
        columns.append([dr.gather(Float, numbers, row * width + k) for k in range(width)])
    return rows(kernel(*columns), tensors[0])


def flat(tensor: Tensor) -> dr.ArrayBase:
    """A tensor's numbers in memory, without a copy where they lie in order."""
    return FLOATS[tensor.dtype](tensor.detach().contiguous().view(-1))


def rows(columns: Iterable[Sequence[dr.ArrayBase]], like: Tensor) -> tuple[Tensor, ...]:
    """A tensor (N, K) for each K columns of N lanes, in the precision of another tensor."""
    Float, outputs = FLOATS[like.dtype], []
    for some in columns:
        n, width = dr.width(some[0]), len(some)
        lane, out = dr.arange(dr.uint32_array_t(Float), n), dr.empty(Float, n * width)
        for k, value in enumerate(some):
            dr.scatter(out, Float(value), lane * width + k, mode=dr.ReduceMode.NoConflicts)
        outputs.append((out, n, width))
    dr.eval([out for out, _, _ in outputs])
    dr.sync_thread()
    return tuple(out.torch().view(n, width) for out, n, width in outputs)
