"""Render and write the pictures of a subject, in this process or in several.

A picture depends on nothing but its :class:`RenderJob`: one process computes all surfaces, and
every job has its own random numbers, so any number of workers writes the same bits.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.data.pictures import write_image
from gva_mi.data.synthetic.camera_effects import CameraEffects
from gva_mi.data.synthetic.estimates import (
    ErrorStatistics,
    PictureErrors,
    write_estimates,
    write_normals,
)
from gva_mi.data.synthetic.render import Renderer, Rendering
from gva_mi.data.synthetic.subject import Subject
from gva_mi.processes import lost, processes
from gva_mi.splat import Camera


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
    light: str = "usual"  # one of gva_mi.data.synthetic.render.LIGHTS


@dataclass(frozen=True)
class RenderResult:
    """What remains in memory of a picture whose files are written."""

    color: np.ndarray  # (H, W, 3) 8-bit
    error: ErrorStatistics | None  # of its mask and normals; None for the ground truth


class RenderPool:
    """Context that renders jobs, in this process or in ``workers`` processes.

    Args:
        subject: who is rendered.
        workers: processes; 1 is this process.
        step: called after each picture.
    """

    def __init__(self, subject: Subject, workers: int, step: Callable[[], None]) -> None:
        self._subject, self._workers, self._step = subject, workers, step
        self._held = ExitStack()
        self._pool: Executor | None = None
        self._renderer = Renderer(subject) if workers == 1 else None

    def __enter__(self) -> RenderPool:
        if self._workers > 1:
            work = processes(self._workers, _start_worker, self._subject)
            self._pool = self._held.enter_context(work)
        return self

    def __exit__(self, *error: Any) -> None:  # noqa: ANN401
        self._held.__exit__(*error)

    def render(self, jobs: Iterable[RenderJob]) -> Iterator[RenderResult]:
        """Render jobs and write their files; yield results in the order of the jobs.

        Raises:
            InputError: a worker process died.
        """
        if self._pool is None:
            for job in jobs:
                yield self._done(render_job(self._renderer, job))
            return
        waiting: deque[Future[RenderResult]] = deque()
        try:
            for job in jobs:  # few ahead, because each holds a surface
                waiting.append(self._pool.submit(_render_in_worker, job))
                if len(waiting) > 2 * self._workers:
                    yield self._done(waiting.popleft().result())
            while waiting:
                yield self._done(waiting.popleft().result())
        except BrokenExecutor as error:
            raise lost(error) from None

    def _done(self, result: RenderResult) -> RenderResult:
        self._step()
        return result


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
