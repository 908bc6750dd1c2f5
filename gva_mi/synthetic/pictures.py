"""Render and write the pictures of a subject, in this process or in several.

A picture depends only on its :class:`RenderJob`: one process computes all surfaces, and
every job has its own random numbers, so any number of workers writes the same bits.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from gva_mi.core.tasks import in_order, worker_processes
from gva_mi.data.folder import TRUTH, SubjectWriter
from gva_mi.synthetic.estimates import PictureErrors, write_estimates, write_pictures
from gva_mi.synthetic.render import Moment, Renderer
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
    # With errors, the ground truth is written into truth/, and the room, if there is one, is shown.
    errors: PictureErrors | None = None


Render = Callable[[Iterable[RenderJob]], Iterator[np.ndarray]]  # 8-bit pictures (H, W, 3)


@contextmanager
def rendering(subject: Subject, room: Room | None, light: str, workers: int) -> Iterator[Render]:
    """Yield a function that renders jobs, writes their files and yields results in order.

    ``light`` is one of LIGHTS; one of ``workers`` is this process.

    Raises:
        InputError: a worker process died.
    """
    if workers == 1:
        yield partial(map, partial(render_job, Renderer(subject, room, light)))
        return
    with worker_processes(workers, _start_worker, subject, room, light) as pool:
        yield partial(in_order, pool, _render_in_worker, ahead=2 * workers)


def render_job(renderer: Renderer, job: RenderJob) -> np.ndarray:
    """Render one picture and write its files; return its colour, 8-bit (H, W, 3)."""
    random, _ = np.random.SeedSequence(job.seed).spawn(2)  # the second is for the errors
    samples, errors = job.samples // len(job.moments), job.errors
    true = renderer.expose(
        job.moments, samples, int(random.generate_state(1)[0]), shown=errors is not None
    )
    stored = np.round(true.color * 255).astype(np.uint8)
    SubjectWriter(job.folder).frame(job.index, stored)
    exact = job.folder if errors is None else job.folder / TRUTH
    write_pictures(exact, job.index, true.mask, true.normals)
    if errors is not None:
        rendered = (true.mask, true.normals) if errors.as_rendered else None
        write_estimates(job.folder, job.index, errors, job.samples, rendered)
    return stored


_renderer: Renderer | None = None  # of a worker process


def _start_worker(subject: Subject, room: Room | None, light: str) -> None:
    global _renderer
    _renderer = Renderer(subject, room, light)


def _render_in_worker(job: RenderJob) -> np.ndarray:
    return render_job(_renderer, job)
