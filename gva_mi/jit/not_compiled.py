"""Functions that ``torch.compile`` must not trace."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from typing import Any

import torch


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
