"""Rowwise kernels: run a Dr.Jit function over the rows of torch tensors, one lane per row.

Kernels are traced at their first call and replayed afterwards (:mod:`gva_mi.jit.frozen`), because
tracing takes longer than running 20,000 rows. The number of rows is a constant of a recording,
because the memory that a kernel allocates is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence

import drjit as dr
from drjit import ArrayBase as Array
from torch import Tensor

from gva_mi.jit.frozen import Frozen, exclusive
from gva_mi.jit.packets import load_rows, store_rows
from gva_mi.jit.tensors import PRECISION, tensor_of, to_drjit

Lane = list[Array]  # the columns of a row


@exclusive
def launch(kernel: Callable[..., Iterable[Lane]], *inputs: Tensor) -> tuple[Tensor, ...]:
    """Run a kernel over the rows of tensors; contiguous ones are not copied.

    Args:
        kernel: a module-level function that takes the K columns of each tensor as a list of
            Dr.Jit arrays, and returns such lists.
        inputs: (N, K), or (1, K) for a row shared by all lanes; of one dtype of :data:`PRECISION`.
            The first has N > 0 rows.

    Returns:
        a tensor (N, K') for each list.
    """
    n = len(inputs[0])
    found = _launch(
        [flat_array(x) for x in inputs],
        n=n,
        kernel=kernel,
        widths=tuple(x.shape[1] for x in inputs),
        shared=tuple(len(x) != n for x in inputs),
    )
    return to_tensors(found, n)


@Frozen
def _launch(
    inputs: list[Array],
    *,
    n: int,
    kernel: Callable[..., Iterable[Lane]],
    widths: tuple[int, ...],
    shared: tuple[bool, ...],
) -> list[Array]:
    lane = dr.arange(dr.uint32_array_t(inputs[0]), n)
    columns = [
        load_columns(x, width, lane * 0 if same else lane)
        for x, width, same in zip(inputs, widths, shared, strict=True)
    ]
    found = [store_columns(result, n, type(inputs[0])) for result in kernel(*columns)]
    dr.eval(found)
    return found


def flat_array(tensor: Tensor) -> Array:
    """Return the memory of a contiguous tensor as a flat array, without a copy."""
    return to_drjit(tensor, PRECISION[tensor.dtype])


def load_columns(numbers: Array, width: int, row: Array) -> Lane:
    """Load the columns of the given rows from a flat array of rows."""
    part = _packet(width)
    packets = range(width // part)
    return [x for k in packets for x in load_rows(numbers, part, row * len(packets) + k)]


def store_columns(columns: Sequence[Array], lanes: int, Float: type) -> Array:
    """Store columns, one number per lane, as a flat array of rows."""
    width, lane = len(columns), dr.arange(dr.uint32_array_t(Float), lanes)
    part, out = _packet(width), dr.empty(Float, lanes * width)
    for k in range(width // part):
        packet = [Float(x) for x in columns[part * k : part * (k + 1)]]
        store_rows(out, packet, lane * (width // part) + k)
    return out


def to_tensors(arrays: Iterable[Array], rows: int) -> tuple[Tensor, ...]:
    """Convert flat arrays of ``rows`` rows to tensors (N, K) when their kernels have finished."""
    dr.sync_thread()
    return tuple(tensor_of(x).view(rows, -1) for x in arrays)


def _packet(width: int) -> int:
    """Return the largest packet that divides a row."""
    return min(width & -width, 8)
