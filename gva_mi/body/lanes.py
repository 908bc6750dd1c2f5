"""Dr.Jit kernels over the rows of torch tensors: a lane for each row."""

from __future__ import annotations

from collections.abc import Callable

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
        flat, width = Float(tensor.detach().contiguous().view(-1)), tensor.shape[1]
        row = lane if len(tensor) == n else dr.zeros(dr.uint32_array_t(Float), n)
        columns.append([dr.gather(Float, flat, row * width + k) for k in range(width)])
    outputs = []
    for rows in kernel(*columns):
        out = dr.empty(Float, n * len(rows))
        for k, value in enumerate(rows):
            dr.scatter(out, value, lane * len(rows) + k, mode=dr.ReduceMode.NoConflicts)
        outputs.append((out, len(rows)))
    dr.eval([out for out, _ in outputs])
    dr.sync_thread()
    return tuple(out.torch().view(n, width) for out, width in outputs)
