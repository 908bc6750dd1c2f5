"""Pictures as padded planes, columns of tables, and functions that torch must not compile."""

from __future__ import annotations

import functools
import math
import sys
from collections.abc import Callable
from typing import Any

import drjit as dr
import numpy as np
import torch
from drjit import ArrayBase as Array
from torch import Tensor

from gva_mi.jit.tensors import to_drjit
from gva_mi.splat.kernels.tiles import Layout


def first_two_columns(table: np.ndarray, rows: Tensor | None = None) -> Tensor:
    """Copy the first two columns of a table (N, 2 k), contiguous, of rows (M,) int64 or all, to a
    tensor.

    A pair is copied as one complex number, by numpy: torch copies rows of two numbers as slowly as
    long ones, and takes longer to be called.
    """
    number = np.complex64 if table.dtype == np.float32 else np.complex128
    pairs = table.view(number)[:, 0]
    if rows is None:
        found = pairs.copy()
    else:  # take() would copy the whole column first if it is not contiguous
        index = rows.numpy()
        found = pairs.take(index) if pairs.flags.contiguous else pairs[index]
    return torch.from_numpy(found.view(table.dtype).reshape(-1, 2))


def image_of(plane: Array, layout: Layout, *channels: int) -> Tensor:
    """Return a plane's own memory as an image (H, W, *channels), without its padding.

    The slice is taken by numpy: torch then sees no view, and lets a caller write into the image.
    """
    numbers = plane.numpy()[: math.prod((*layout.padded, *channels))]
    padded = numbers.reshape(*layout.padded, *channels)
    return torch.from_numpy(padded[: layout.height, : layout.width])


def plane_of(image: Tensor | None, layout: Layout, F: type, *channels: int) -> Array:
    """Return an image as a plane, padded with zeros; zeros if there is no image."""
    if image is None:
        return dr.opaque(F, 0, math.prod((*layout.padded, *channels)))
    if image.shape[:2] != layout.padded:
        padded = image.new_zeros(*layout.padded, *channels)
        padded[: layout.height, : layout.width] = image
        image = padded
    return to_drjit(image, F)


def not_compiled(function: Callable[..., Any]) -> Callable[..., Any]:
    """Exclude a function from ``torch.compile``, which cannot trace Dr.Jit's kernels.

    ``torch.compiler.disable`` imports the compiler, which takes as long as importing torch. So it
    is called only if the program has imported the compiler.
    """
    excluded = None

    @functools.wraps(function)
    def call(*arguments: Any, **options: Any) -> Any:  # noqa: ANN401
        nonlocal excluded
        if "torch._dynamo" not in sys.modules:
            return function(*arguments, **options)
        if excluded is None:
            excluded = torch.compiler.disable(function)
        return excluded(*arguments, **options)

    return call
