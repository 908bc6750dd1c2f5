"""What the first picture of a process costs, its kernels compiled by an earlier one.

The file is a module of the bench, and the program of the process that is measured: that one is
started with nothing imported, and says what each step took.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass

GAUSSIANS, SIZE = 20_000, 512  # px


@dataclass(frozen=True)
class FirstCall:
    """Seconds of a process that draws one picture, the least of several processes."""

    torch: float  # to import it
    splat: float  # to import gva_mi.splat after it, Dr.Jit included
    first: float  # forward and backward
    second: float  # the same again
    compiled: int  # kernels that were not found on disk; 0 but where the disk keeps none

    def line(self) -> str:
        """For the table."""
        imports = f"imports before: torch {self.torch:.2f} s, gva_mi.splat {self.splat:.2f} s"
        compiled = f"; {self.compiled} kernels compiled" if self.compiled else ""
        again = f"the second {self.second:.2f} s"
        return f"first call of a process: {self.first:.2f} s, {again}; {imports}{compiled}"


def measure_first_call(processes: int) -> FirstCall:
    """Measure after one process more, which leaves the kernels on disk."""
    places = os.pathsep.join(path for path in sys.path if path)  # where this process finds packages
    command = [sys.executable, "-P", __file__]
    runs = []
    for _ in range(processes + 1):
        environment = os.environ | {"PYTHONPATH": places}
        run = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
        runs.append(json.loads(run.stdout))
    return FirstCall(**{name: min(run[name] for run in runs[1:]) for name in runs[0]})


def _measure() -> dict[str, float]:
    """The fields of :class:`FirstCall`, of this process."""
    start = time.perf_counter()
    import torch

    with_torch = time.perf_counter()
    import drjit as dr

    from gva_mi.splat import Camera, Gaussians, SplatOptions, look_at, render

    imported = time.perf_counter()
    generator = torch.Generator().manual_seed(0)
    normal = lambda *shape: torch.randn(*shape, generator=generator)
    arrays = {
        "means": normal(GAUSSIANS, 3),
        "quats": normal(GAUSSIANS, 4),
        "scales": torch.full((GAUSSIANS, 3), 0.02),
        "opacities": torch.full((GAUSSIANS,), 0.8),
        "sh": 0.1 * normal(GAUSSIANS, 16, 3),
    }
    inputs = [array.requires_grad_() for array in arrays.values()]
    camera = Camera(SIZE, SIZE, SIZE / 2, SIZE / 2, look_at((0, 0, 6), (0, 0, 0)), SIZE, SIZE)
    gaussians, weights = Gaussians(**arrays), normal(SIZE, SIZE, 3)

    def seconds() -> float:
        begun = time.perf_counter()
        image = render(gaussians, camera, SplatOptions(depth=False))
        torch.autograd.grad(image.color, inputs, weights)
        return time.perf_counter() - begun

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        first = seconds()
    kernels = dr.kernel_history((dr.KernelType.JIT,))
    compiled = sum(not kernel["cache_hit"] for kernel in kernels)
    times = {"torch": with_torch - start, "splat": imported - with_torch}
    return times | {"first": first, "second": seconds(), "compiled": compiled}


if __name__ == "__main__":
    sys.stdout.write(json.dumps(_measure()))
