"""How torch and Dr.Jit share the cores."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Leave the cores to Dr.Jit: after each operation torch's OpenMP threads would spin on them.

    On two cores one thread is 1.3 to 20 times faster for tensors as small as ours, the more the
    busier the cores are, and it makes every sum independent of their number.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
