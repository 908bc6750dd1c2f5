"""Takes the pictures of a subject, one after the other or in several processes.

A picture depends on nothing but its :class:`Shot`: surfaces are computed in one process, and every
shot has random numbers of its own, so that any number of workers writes the same bits.
"""

from __future__ import annotations

import multiprocessing
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from gva_mi.data.pictures import write_image
from gva_mi.data.synthetic import exposure as sensor
from gva_mi.data.synthetic import noise
from gva_mi.data.synthetic.render import Renderer
from gva_mi.data.synthetic.subject import Subject
from gva_mi.splat import Camera


@dataclass(frozen=True)
class Stage1:
    """How the pictures of the video differ from the truth; levels, 0 is exact."""

    folder: Path  # where the true masks and normals go
    mask: float
    normal: float
    blur: float  # px
    sensor: float
    behind: np.ndarray | None  # (H, W, 3) the background; None is white


@dataclass(frozen=True)
class Shot:
    """One picture to take."""

    folder: Path  # gets frames/, masks/, normals/
    index: int
    surface: np.ndarray  # (N, 3) float32, world, metres
    camera: Camera
    samples: int  # rays per pixel
    seed: tuple[int, ...]  # of everything random in it
    stage1: Stage1 | None = None  # None: everything is the truth


@dataclass(frozen=True)
class Taken:
    """What the makers of a video need to know about a picture."""

    color: np.ndarray  # (H, W, 3) 8-bit
    iou: float  # of the mask with the true one
    angle: float  # degrees, of the normals from the true ones


class Studio:
    """Who takes the pictures; a context, for its processes end with it.

    Args:
        subject: who is taken.
        workers: processes; with 1, this process does it.
        step: called after each picture.
    """

    def __init__(self, subject: Subject, workers: int, step: Callable[[], None]) -> None:
        self._workers, self._step = workers, step
        self._pool = self._renderer = None
        if workers > 1:
            self._pool = ProcessPoolExecutor(
                workers, multiprocessing.get_context("spawn"), _start_worker, (subject,)
            )
        else:
            self._renderer = Renderer(subject)

    def __enter__(self) -> Studio:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def take(self, shots: Iterable[Shot]) -> Iterator[Taken]:
        """The pictures of some shots, in their order; their files are written."""
        if self._pool is None:
            for shot in shots:
                yield self._done(take(self._renderer, shot))
            return
        waiting: deque = deque()
        for shot in shots:  # few ahead: each holds a surface
            waiting.append(self._pool.submit(_take_in_worker, shot))
            if len(waiting) > 2 * self._workers:
                yield self._done(waiting.popleft().result())
        while waiting:
            yield self._done(waiting.popleft().result())

    def _done(self, taken: Taken) -> Taken:
        self._step()
        return taken


def take(renderer: Renderer, shot: Shot) -> Taken:
    """Take one picture and write its files."""
    seeds = np.random.SeedSequence(shot.seed)
    light, errors = seeds.spawn(2)
    seed = int(light.generate_state(1)[0])
    picture = renderer(shot.surface, shot.camera, shot.samples, seed)
    color, mask, normals = picture.color, picture.mask, picture.normals
    if (stage1 := shot.stage1) is not None:
        of_mask, of_normals, of_sensor = (np.random.default_rng(s) for s in errors.spawn(3))
        mask = noise.noisy_mask(mask, stage1.mask, of_mask)
        normals = noise.noisy_normals(normals, mask, stage1.normal, of_normals)
        if stage1.behind is not None:
            color = sensor.before_backdrop(color, picture.mask, stage1.behind)
        color = sensor.exposed(color, stage1.blur, stage1.sensor, of_sensor)
        _write(stage1.folder, shot.index, picture.mask, picture.normals)
    stored = np.round(color * 255).astype(np.uint8)
    write_image(shot.folder / "frames" / f"{shot.index:06d}.png", stored)
    _write(shot.folder, shot.index, mask, normals)
    iou = noise.mask_iou(mask, picture.mask)
    return Taken(stored, iou, noise.normal_error(normals, picture.normals))


def _write(folder: Path, index: int, mask: np.ndarray, normals: np.ndarray) -> None:
    write_image(folder / "masks" / f"{index:06d}.png", mask)
    write_image(folder / "normals" / f"{index:06d}.png", (normals + 1) / 2)


_renderer: Renderer | None = None  # of a worker process


def _start_worker(subject: Subject) -> None:
    global _renderer
    _renderer = Renderer(subject)


def _take_in_worker(shot: Shot) -> Taken:
    return take(_renderer, shot)
