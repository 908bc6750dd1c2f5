"""Split the time of a piece of work: kernels of Dr.Jit, operations of torch, and what is left.

What is left is Python, tracing, launches, copies and autograd's bookkeeping. Measuring the parts
slows the work down, so its whole time comes from another measurement.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import drjit as dr
from torch.profiler import ProfilerActivity, profile

LETTER = 0.2  # ms of a letter in the bar

os.environ.setdefault("KINETO_LOG_LEVEL", "99")  # else torch's profiler prints lines of its own


class PartClock:
    """Measure the parts of each block ``with clock(name)``, by name, in milliseconds."""

    def __init__(self) -> None:
        self.found: dict[str, list[tuple[float, float, int]]] = {}

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Measure one piece of work, up to the end of its kernels."""
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            with profile(activities=[ProfilerActivity.CPU], acc_events=True) as record:
                yield
                dr.sync_thread()
            kernels = dr.kernel_history()
        operations = [x for x in record.key_averages() if x.key.startswith("aten::")]
        of_torch = sum(x.self_cpu_time_total for x in operations) / 1e3
        of_kernels = sum(kernel["execution_time"] for kernel in kernels)
        self.found.setdefault(name, []).append((of_kernels, of_torch, len(kernels)))

    def columns(self, name: str, whole: float, warm_up: int) -> dict[str, float | int | str]:
        """Return the cells of a table row.

        Args:
            name: of the work.
            whole: its time, ms.
            warm_up: first calls that do not count.
        """
        kernels, of_torch, launches = map(min, zip(*self.found[name][warm_up:], strict=True))
        rest = max(0.0, whole - kernels - of_torch)
        parts = {"k": kernels, "t": of_torch, ".": rest}
        bar = "".join(letter * round(part / LETTER) for letter, part in parts.items())
        title = f"a letter: {LETTER} ms of kernels (k), torch (t), the rest (.)"
        return {"kernels": kernels, "torch": of_torch, "launches": launches, title: bar}
