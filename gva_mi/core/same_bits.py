"""Functions of tensors that give the same bits on every CPU, where torch's own do not.

On a CPU torch computes ``sqrt``, ``acos``, ``asin`` and ``atan`` with MKL's vector functions. These
begin with the CPU's own estimate of 1/x or 1/√x, so their last digits differ between makers.
"""

from torch import Tensor


def sqrt(x: Tensor) -> Tensor:
    """Return √x, of the same shape, from a division and a square root that IEEE 754 rounds."""
    return x.rsqrt().reciprocal()
