"""How fast ``mesh_normals`` is: one step of a refinement, stage by stage.

The puppet (22,000 faces) fills the height of a square picture. At each step it stands a little
elsewhere, as in a fit, so that nothing can be kept from the step before. Times are wall clock, the
least and the median; on a shared machine trust ratios of one run.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import NamedTuple

import numpy as np
import torch

from gva_mi.body.smplx import load_body
from gva_mi.mesh.mesh_scene import MeshScene
from gva_mi.splat import Camera, look_at

SIZES = (256, 512)  # pixels
STEP = 1e-3  # metres from one step to the next
_WARM_UP = 4  # steps before the first that counts


class Milliseconds(NamedTuple):
    """How long one stage takes."""

    least: float
    median: float


@dataclass(frozen=True)
class StageTimes:
    """How long the stages of a step take at one size; the last is the whole step."""

    size: int  # pixels
    stages: dict[str, Milliseconds]


@dataclass(frozen=True)
class NormalsBench:
    """All figures of one run."""

    faces: int
    threads: int  # of Dr.Jit
    sizes: tuple[StageTimes, ...]

    def to_dict(self) -> dict:
        """For JSON."""
        return asdict(self)

    def table(self) -> str:
        """For a person to read."""
        lines = [f"{self.faces:,} faces, 1 ray a pixel, {self.threads} threads"]
        for size in self.sizes:
            lines += ["", f"{size.size} x {size.size} pixels{'least, ms':>16}{'median, ms':>12}"]
            lines += [
                f"{name:20}{found.least:12.1f}{found.median:12.1f}"
                for name, found in size.stages.items()
            ]
        return "\n".join(lines)


def bench_normals(repeats: int, seed: int) -> NormalsBench:
    """Measure the plugin.

    Args:
        repeats: steps that count.
        seed: of the gradient that comes back.
    """
    import drjit as dr

    body = load_body()
    scene = MeshScene(body.faces, body.v_template)
    sizes = tuple(_stage_times(scene, body.v_template, size, repeats, seed) for size in SIZES)
    return NormalsBench(len(body.faces), dr.thread_count(), sizes)


class _Stopwatch:
    """Wall-clock times of named stages, in milliseconds."""

    def __init__(self) -> None:
        self.times: dict[str, list[float]] = {}

    def time(self, stage: str, work: Callable[[], object]) -> None:
        """Do the work of a stage, up to the end of its kernels."""
        import drjit as dr

        begin = time.perf_counter()
        made = work()
        if made is not None:
            dr.eval(made)
        dr.sync_thread()
        self.times.setdefault(stage, []).append(1e3 * (time.perf_counter() - begin))


def _stage_times(
    scene: MeshScene, template: torch.Tensor, size: int, repeats: int, seed: int
) -> StageTimes:
    import mitsuba as mi

    centre = template.mean(0).numpy()
    focal, half = 1.2 * size, size / 2
    T_camera_world = look_at(centre + (0.2, 0.1, 2.6), centre)
    camera = Camera(focal, focal, half, half, T_camera_world, size, size)
    noise = np.random.default_rng(seed).normal(size=(size, size, 4))
    grad = mi.TensorXf(noise.astype(np.float32))
    view = scene.view(template, camera)
    watch = _Stopwatch()
    for k in range(_WARM_UP + repeats):
        moved = template + STEP * (k + 1)

        def forward(moved: torch.Tensor = moved) -> mi.TensorXf:
            nonlocal view
            view = scene.view(moved, camera)
            return view.image()

        watch.time("update", lambda moved=moved: scene.show(moved))
        watch.time("forward", forward)
        watch.time("backward", lambda: view.adjoint(grad))
    counted = {name: times[_WARM_UP:] for name, times in watch.times.items()}
    counted["whole step"] = [sum(step) for step in zip(*counted.values(), strict=True)]
    stages = {
        name: Milliseconds(min(times), statistics.median(times)) for name, times in counted.items()
    }
    return StageTimes(size, stages)
