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

import numpy as np
import torch

from gva_mi.body.smplx import load_body
from gva_mi.mesh.mesh_scene import BodyScene
from gva_mi.splat import Camera, look_at

SIZES = (256, 512)  # pixels
STEP = 1e-3  # metres from one step to the next
_WARM_UP = 4  # steps before the first that counts


@dataclass(frozen=True)
class PictureSize:
    """Milliseconds, least and median, of each stage; the last is the whole step."""

    size: int  # pixels
    stages: dict[str, tuple[float, float]]


@dataclass(frozen=True)
class NormalsBench:
    """All figures of one run."""

    faces: int
    threads: int  # of Dr.Jit
    sizes: tuple[PictureSize, ...]

    def to_dict(self) -> dict:
        """For JSON."""
        return asdict(self)

    def table(self) -> str:
        """For a person to read."""
        lines = [f"{self.faces:,} faces, 1 ray a pixel, {self.threads} threads"]
        for found in self.sizes:
            lines += ["", f"{found.size} x {found.size} pixels{'least, ms':>16}{'median, ms':>12}"]
            lines += [
                f"{name:20}{least:12.1f}{median:12.1f}"
                for name, (least, median) in found.stages.items()
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
    scene = BodyScene(body.faces, body.v_template)
    sizes = tuple(_steps(scene, body.v_template, size, repeats, seed) for size in SIZES)
    return NormalsBench(len(body.faces), dr.thread_count(), sizes)


def _steps(
    scene: BodyScene, template: torch.Tensor, size: int, repeats: int, seed: int
) -> PictureSize:
    import drjit as dr
    import mitsuba as mi

    centre = template.mean(0).numpy()
    focal, half = 1.2 * size, size / 2
    T_camera_world = look_at(centre + (0.2, 0.1, 2.6), centre)
    camera = Camera(focal, focal, half, half, T_camera_world, size, size)
    noise = np.random.default_rng(seed).normal(size=(size, size, 4))
    grad = mi.TensorXf(noise.astype(np.float32))
    view = scene.view(template, camera)
    stages: dict[str, list[float]] = {name: [] for name in ("update", "forward", "backward")}

    def timed(stage: str, work: Callable[[], object]) -> object:
        begin = time.perf_counter()
        made = work()
        if made is not None:
            dr.eval(made)
        dr.sync_thread()
        stages[stage].append(1e3 * (time.perf_counter() - begin))
        return made

    for k in range(_WARM_UP + repeats):
        moved = template + STEP * (k + 1)
        timed("update", lambda moved=moved: scene.show(moved))

        def forward(moved: torch.Tensor = moved) -> mi.TensorXf:
            nonlocal view
            view = scene.view(moved, camera)
            return view.image()

        timed("forward", forward)
        timed("backward", lambda: view.adjoint(grad))
    counted = {name: times[_WARM_UP:] for name, times in stages.items()}
    counted["whole step"] = [sum(step) for step in zip(*counted.values(), strict=True)]
    return PictureSize(
        size, {name: (min(times), statistics.median(times)) for name, times in counted.items()}
    )
