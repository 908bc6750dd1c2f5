"""What is timed: one forward pass, and one forward and backward pass, through torch."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import drjit as dr
import numpy as np
import torch
from drjit.llvm import Float
from torch import Tensor

from gva_mi.splat.kernels import passes
from gva_mi.splat.kernels.inputs import Inputs
from gva_mi.splat.kernels.passes import Saved
from gva_mi.splat.scene import Scene
from gva_mi.splat.torch_op import render


@dataclass(frozen=True)
class Timing:
    """How long repeated calls take."""

    least: float  # ms
    median: float  # ms

    @staticmethod
    def of(seconds: list[float]) -> Timing:
        """From the seconds of each call."""
        return Timing(1e3 * min(seconds), 1e3 * statistics.median(seconds))

    def __str__(self) -> str:
        return f"{self.least:9.2f} {self.median:9.2f}"


@dataclass(frozen=True)
class Work:
    """A scene in float32, and what a caller does with it."""

    scene: Scene
    weights: Tensor  # (H, W, D), the gradient that the picture is given: no loss is timed

    @staticmethod
    def on(scene: Scene, seed: int = 0) -> Work:
        """``scene`` in float32, with random weights."""
        scene = scene.to(torch.float32)
        size = (scene.camera.height, scene.camera.width, len(scene.background))
        weights = torch.randn(size, generator=torch.Generator().manual_seed(seed))
        return Work(scene, weights)

    def forward(self) -> None:
        """The picture alone."""
        s = self.scene
        with torch.no_grad():
            render(s.gaussians, s.camera, s.options, s.background)

    def both(self) -> None:
        """The picture, and its gradient by every input."""
        s = self.scene
        image = render(s.gaussians, s.camera, s.options, s.background)
        torch.autograd.grad(image.color, list(s.inputs().values()), self.weights)

    def saved(self) -> Saved:
        """What the kernels save of a picture."""
        s = self.scene
        flat = [Float(v.detach().contiguous().view(-1)) for v in s.gaussians.arrays().values()]
        harmonics, behind = s.gaussians.sh is not None, s.background.tolist()
        return passes.render_forward(Inputs(*flat), harmonics, s.camera, s.options, behind)


def repeated(run: Callable[[], None], repeats: int) -> Timing:
    """How long calls take, after two that compile and allocate."""
    run(), run()
    return Timing.of([seconds(run) for _ in range(repeats)])


def seconds(run: Callable[[], None]) -> float:
    """Wall clock until the last kernel has ended."""
    start = time.perf_counter()
    run()
    dr.sync_thread()
    return time.perf_counter() - start


def by_turns(ways: Sequence[Callable[[], None]], calls: int) -> tuple[list[Timing], list[float]]:
    """Time several ways in turn, so that the machine's other work falls on all.

    Returns:
        The timing of each, and the median of how long it takes beside the first.
    """
    times: list[list[float]] = [[] for _ in ways]
    for k in range(calls + 2):  # two that compile and allocate
        for found, way in zip(times, ways, strict=True):
            taken = seconds(way)
            if k >= 2:
                found.append(taken)
    beside = [statistics.median(a / b for a, b in zip(own, times[0], strict=True)) for own in times]
    return [Timing.of(own) for own in times], beside


def pairs_of(saved: Saved) -> int:
    """Pairs (tile, Gaussian) in the lists."""
    return 0 if saved.lists is None else int(saved.lists.counts.numpy().sum(dtype=np.int64))


def walked_of(saved: Saved) -> int:
    """Pairs that the compositing reached before all pixels of their tile were opaque."""
    if saved.lists is None:
        return 0
    real = saved.lists.real.numpy()
    steps = saved.stop.numpy().astype(np.int64) - saved.lists.start.numpy()
    return int(np.maximum(steps[real], 0).sum())
