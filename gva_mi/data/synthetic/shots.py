"""Renders and writes the pictures of a subject, in this process or in several.

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
from gva_mi.data.synthetic import camera_effects, noise
from gva_mi.data.synthetic.render import Renderer
from gva_mi.data.synthetic.subject import Subject
from gva_mi.splat import Camera


@dataclass(frozen=True)
class Degradation:
    """How the pictures of a video differ from the truth; a level of 0 is exact."""

    truth: Path  # folder that gets the true masks and normals
    mask: float  # level of the mask's noise
    normal: float  # level of the normals' noise
    blur: float  # px, standard deviation
    sensor: float  # level of the sensor's noise
    background: np.ndarray | None  # (H, W, 3); None is white


@dataclass(frozen=True)
class Shot:
    """One picture to render."""

    folder: Path  # gets frames/, masks/, normals/
    index: int
    surface: np.ndarray  # (N, 3) float32, world, metres
    camera: Camera
    samples: int  # rays per pixel
    seed: tuple[int, ...]  # of everything random in it
    degradation: Degradation | None = None  # None: everything is the truth


@dataclass(frozen=True)
class ShotResult:
    """What is left to know of a picture whose files are written."""

    color: np.ndarray  # (H, W, 3) 8-bit
    iou: float  # of the mask with the true one
    angle: float  # degrees, of the normals from the true ones


class ShotPool:
    """Renders shots; a context, for its processes end with it.

    Args:
        subject: who is rendered.
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

    def __enter__(self) -> ShotPool:
        return self

    def __exit__(self, *_: object) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def render(self, shots: Iterable[Shot]) -> Iterator[ShotResult]:
        """Render some shots and write their files; the results come in the order of the shots."""
        if self._pool is None:
            for shot in shots:
                yield self._done(render_shot(self._renderer, shot))
            return
        waiting: deque = deque()
        for shot in shots:  # few ahead: each holds a surface
            waiting.append(self._pool.submit(_render_in_worker, shot))
            if len(waiting) > 2 * self._workers:
                yield self._done(waiting.popleft().result())
        while waiting:
            yield self._done(waiting.popleft().result())

    def _done(self, result: ShotResult) -> ShotResult:
        self._step()
        return result


def render_shot(renderer: Renderer, shot: Shot) -> ShotResult:
    """Render one picture and write its files."""
    light, errors = np.random.SeedSequence(shot.seed).spawn(2)
    seed = int(light.generate_state(1)[0])
    true = renderer(shot.surface, shot.camera, shot.samples, seed)
    color, mask, normals = true.color, true.mask, true.normals
    if (worse := shot.degradation) is not None:
        of_mask, of_normals, of_sensor = (np.random.default_rng(s) for s in errors.spawn(3))
        mask = noise.noisy_mask(mask, worse.mask, of_mask)
        normals = noise.noisy_normals(normals, mask, worse.normal, of_normals)
        if worse.background is not None:
            color = camera_effects.over_background(color, true.mask, worse.background)
        color = camera_effects.blur_and_noise(color, worse.blur, worse.sensor, of_sensor)
        _write(worse.truth, shot.index, true.mask, true.normals)
    stored = np.round(color * 255).astype(np.uint8)
    write_image(shot.folder / "frames" / f"{shot.index:06d}.png", stored)
    _write(shot.folder, shot.index, mask, normals)
    iou = noise.mask_iou(mask, true.mask)
    return ShotResult(stored, iou, noise.normal_error(normals, true.normals))


def _write(folder: Path, index: int, mask: np.ndarray, normals: np.ndarray) -> None:
    write_image(folder / "masks" / f"{index:06d}.png", mask)
    write_image(folder / "normals" / f"{index:06d}.png", (normals + 1) / 2)


_renderer: Renderer | None = None  # of a worker process


def _start_worker(subject: Subject) -> None:
    global _renderer
    _renderer = Renderer(subject)


def _render_in_worker(shot: Shot) -> ShotResult:
    return render_shot(_renderer, shot)
