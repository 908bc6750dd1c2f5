"""Render and write the pictures of a subject, in this process or in several.

A picture depends on nothing but its :class:`RenderJob`: one process computes all surfaces, and
every job has its own random numbers, so any number of workers writes the same bits.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from gva_mi.core.workers import worker_died, worker_processes
from gva_mi.data.pictures import write_image
from gva_mi.splat import Camera
from gva_mi.synthetic.camera_effects import CameraEffects
from gva_mi.synthetic.estimates import (
    ErrorStatistics,
    PictureErrors,
    write_estimates,
    write_normals,
)
from gva_mi.synthetic.render import Renderer, Rendering
from gva_mi.synthetic.subject import Subject


@dataclass(frozen=True)
class Degradation:
    """How a video's picture differs from the ground truth, which is written beside it."""

    effects: CameraEffects
    errors: PictureErrors  # of its mask and normals
    from_files: bool  # whether these start from the 8-bit files of the ground truth


@dataclass(frozen=True)
class RenderJob:
    """One picture to render."""

    folder: Path  # gets frames/, masks/, normals/
    index: int
    surface: np.ndarray  # (N, 3) float32, world, metres
    camera: Camera
    samples: int  # rays per pixel
    seed: tuple[int, ...]  # of everything random in it
    degradation: Degradation | None = None  # None writes the ground truth alone
    light: str = "usual"  # one of gva_mi.synthetic.render.LIGHTS


@dataclass(frozen=True)
class RenderResult:
    """What remains in memory of a picture whose files are written."""

    color: np.ndarray  # (H, W, 3) 8-bit
    error: ErrorStatistics | None  # of its mask and normals; None for the ground truth


Render = Callable[[Iterable[RenderJob]], Iterator[RenderResult]]


@contextmanager
def rendering(subject: Subject, workers: int, step: Callable[[], None]) -> Iterator[Render]:
    """Yield a function that renders jobs, writes their files and yields results in order.

    Args:
        subject: who is rendered.
        workers: processes; 1 is this process.
        step: called after each picture.

    Raises:
        InputError: a worker process died.
    """
    with ExitStack() as stack:
        if workers == 1:
            results = partial(map, partial(render_job, Renderer(subject)))
        else:
            pool = stack.enter_context(worker_processes(workers, _start_worker, subject))
            results = partial(_in_order, pool, 2 * workers)

        def render(jobs: Iterable[RenderJob]) -> Iterator[RenderResult]:
            for result in results(jobs):
                step()
                yield result

        yield render


def _in_order(pool: Executor, ahead: int, jobs: Iterable[RenderJob]) -> Iterator[RenderResult]:
    """Submit at most ``ahead`` jobs at a time, because each holds a surface."""
    waiting: deque[Future[RenderResult]] = deque()
    try:
        for job in jobs:
            waiting.append(pool.submit(_render_in_worker, job))
            if len(waiting) > ahead:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    except BrokenExecutor as error:
        raise worker_died(error) from None


def render_job(renderer: Renderer, job: RenderJob) -> RenderResult:
    """Render one picture and write its files."""
    light, errors = np.random.SeedSequence(job.seed).spawn(2)
    seed = int(light.generate_state(1)[0])
    true = renderer(job.surface, job.camera, job.samples, seed, job.light)
    color, error = true.color, None
    if job.degradation is None:
        _write_true(job.folder, job.index, true)
    else:
        sensor = np.random.default_rng(errors.spawn(3)[2])  # 0 and 1 are for mask and normals
        color = job.degradation.effects.apply(color, true.mask, sensor)
        _write_true(job.folder / "truth", job.index, true)
        rendered = None if job.degradation.from_files else (true.mask, true.normals)
        error = write_estimates(
            job.folder, job.index, job.degradation.errors, job.samples, rendered
        )
    stored = np.round(color * 255).astype(np.uint8)
    write_image(job.folder / "frames" / f"{job.index:06d}.png", stored)
    return RenderResult(stored, error)


def _write_true(folder: Path, index: int, true: Rendering) -> None:
    write_image(folder / "masks" / f"{index:06d}.png", true.mask)
    write_normals(folder, index, true.normals)


_renderer: Renderer | None = None  # of a worker process


def _start_worker(subject: Subject) -> None:
    global _renderer
    _renderer = Renderer(subject)


def _render_in_worker(job: RenderJob) -> RenderResult:
    return render_job(_renderer, job)
