"""What a script costs that sets nothing, beside one whose torch threads were told not to spin.

The file is a module of the bench, and the program of the processes that are measured. A step is
what a training does: a picture, a loss that torch computes on all cores, and the way back. Timed
are picture and way back, which is where the threads of the loss would spin; not the loss itself.
"""

from __future__ import annotations

import json
import os
import statistics
import subprocess
import sys
import time
from dataclasses import dataclass

GAUSSIANS, SIZE = 20_000, 512  # px
VARIABLE, BEST = "OMP_WAIT_POLICY", "PASSIVE"
OPENMP = ("OMP_", "GOMP_", "KMP_")  # how the names of its settings begin


@dataclass(frozen=True)
class Environment:
    """Milliseconds of a forward and backward pass in processes of their own."""

    plain: float  # nothing set: the least of all processes
    best: float  # the variable set before torch is imported
    ratio: float  # of the medians of two processes one after the other: the median

    def line(self) -> str:
        """For the table."""
        times = f"{self.plain:.2f} and {self.best:.2f} ms at least"
        best = f"one with {VARIABLE}={BEST} ({times})"
        return f"a script that sets nothing: {self.ratio:.2f} x {best}"


def measure_environment(rounds: int, calls: int) -> Environment:
    """Measure two processes a round, one after the other; each takes ``calls`` steps."""
    plain, best = [], []
    for _ in range(rounds):
        plain.append(_steps(calls, {}))
        best.append(_steps(calls, {VARIABLE: BEST}))
    middle = statistics.median
    ratio = middle(middle(a) / middle(b) for a, b in zip(plain, best, strict=True))
    return Environment(min(map(min, plain)), min(map(min, best)), ratio)


def _steps(calls: int, settings: dict[str, str]) -> list[float]:
    """Milliseconds of each step of a process with these settings and no others of OpenMP's."""
    own = {k: v for k, v in os.environ.items() if not k.startswith(OPENMP)}
    places = os.pathsep.join(path for path in sys.path if path)  # where this process finds packages
    environment = own | {"PYTHONPATH": places} | settings
    command = [sys.executable, "-P", __file__, str(calls)]
    run = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return json.loads(run.stdout)


def _measure(calls: int) -> list[float]:
    """What :func:`_steps` returns, of this process."""
    import numpy as np
    import torch

    from gva_mi.splat import render
    from gva_mi.splat.bench.timing import Work, seconds
    from gva_mi.splat.scene import person_scene

    work = Work.on(person_scene(np.random.default_rng(0), GAUSSIANS, SIZE))
    scene, inputs = work.scene, list(work.scene.inputs().values())

    def step() -> float:
        start = time.perf_counter()
        color = render(scene.gaussians, scene.camera, scene.options, scene.background).color
        there = time.perf_counter() - start
        picture = color.detach().requires_grad_()
        (picture - work.weights).square().mean().backward()
        return there + seconds(lambda: torch.autograd.grad(color, inputs, picture.grad))

    return [1e3 * step() for _ in range(calls + 2)][2:]  # two that compile and allocate


if __name__ == "__main__":
    sys.stdout.write(json.dumps(_measure(int(sys.argv[1]))))
