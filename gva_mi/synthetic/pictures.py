"""Render and write the pictures of a subject, in this process or in several.

A picture depends only on its :class:`RenderJob`: one process computes all surfaces, and
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
from gva_mi.synthetic.estimates import (
    ErrorStatistics,
    PictureErrors,
    write_estimates,
    write_normals,
)
from gva_mi.synthetic.render import Moment, Renderer, Rendering
from gva_mi.synthetic.rooms.room import Room
from gva_mi.synthetic.subject import Subject


@dataclass(frozen=True)
class RenderJob:
    """One picture to render."""

    folder: Path  # gets frames/, masks/, normals/
    index: int
    moments: tuple[Moment, ...]  # of the exposure
    samples: int  # rays per pixel
    seed: tuple[int, ...]  # seed of its random numbers
    light: str  # one of gva_mi.synthetic.lamps.LIGHTS
    in_room: bool  # show the room, if there is one
    errors: PictureErrors | None = None  # None writes the ground truth alone, else into truth/


# 8-bit color (H, W, 3), and the errors of mask and normals; None for the ground truth.
RenderResult = tuple[np.ndarray, ErrorStatistics | None]
Render = Callable[[Iterable[RenderJob]], Iterator[RenderResult]]


@contextmanager
def rendering(
    subject: Subject, room: Room | None, workers: int, step: Callable[[], None]
) -> Iterator[Render]:
    """Yield a function that renders jobs, writes their files and yields results in order.

    One of ``workers`` is this process. ``step`` is called after each picture.

    Raises:
        InputError: a worker process died.
    """
    with ExitStack() as stack:
        if workers == 1:
            results = partial(map, partial(render_job, Renderer(subject, room)))
        else:
            pool = stack.enter_context(worker_processes(workers, _start_worker, subject, room))
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
    light, _ = np.random.SeedSequence(job.seed).spawn(2)  # the second is for the errors
    seed = int(light.generate_state(1)[0])
    samples = job.samples // len(job.moments)
    true = renderer.expose(job.moments, samples, seed, job.light, job.in_room)
    stored = np.round(true.color * 255).astype(np.uint8)
    write_image(job.folder / "frames" / f"{job.index:06d}.png", stored)
    if job.errors is None:
        _write_true(job.folder, job.index, true)
        return stored, None
    _write_true(job.folder / "truth", job.index, true)
    rendered = (true.mask, true.normals) if job.errors.as_rendered else None
    return stored, write_estimates(job.folder, job.index, job.errors, job.samples, rendered)


def _write_true(folder: Path, index: int, true: Rendering) -> None:
    write_image(folder / "masks" / f"{index:06d}.png", true.mask)
    write_normals(folder, index, true.normals)


_renderer: Renderer | None = None  # of a worker process


def _start_worker(subject: Subject, room: Room | None) -> None:
    global _renderer
    _renderer = Renderer(subject, room)


def _render_in_worker(job: RenderJob) -> RenderResult:
    return render_job(_renderer, job)
