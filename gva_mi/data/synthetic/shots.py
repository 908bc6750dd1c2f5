"""Renders and writes the pictures of a subject, in this process or in several.

A picture depends on nothing but its :class:`Shot`: surfaces are computed in one process, and every
shot has random numbers of its own, so that any number of workers writes the same bits.
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
from gva_mi.data.synthetic import camera_effects
from gva_mi.data.synthetic.estimates import PictureError, spoil_pictures, write_normals
from gva_mi.data.synthetic.noise.pictures import PictureNoise
from gva_mi.data.synthetic.render import Renderer, Rendering
from gva_mi.data.synthetic.subject import Subject
from gva_mi.processes import lost, processes
from gva_mi.splat import Camera


@dataclass(frozen=True)
class CameraEffects:
    """What the camera of a video adds to its clean pictures."""

    blur: float  # px, standard deviation
    sensor: float  # level of the sensor's noise; 0 is none
    background: np.ndarray | None  # (H, W, 3); None is white


@dataclass(frozen=True)
class Taken:
    """How a video's picture differs from the truth, which goes to ``truth`` beside it."""

    effects: CameraEffects
    noise: PictureNoise  # of its mask and normals
    from_files: bool  # whether that starts from the files of the truth, 8 bits a channel


@dataclass(frozen=True)
class Shot:
    """One picture to render."""

    folder: Path  # gets frames/, masks/, normals/
    index: int
    surface: np.ndarray  # (N, 3) float32, world, metres
    camera: Camera
    samples: int  # rays per pixel
    seed: tuple[int, ...]  # of everything random in it
    taken: Taken | None = None  # None: everything is the truth
    light: str = "usual"  # one of gva_mi.data.synthetic.render.LIGHTS


@dataclass(frozen=True)
class ShotResult:
    """What is left to know of a picture whose files are written."""

    color: np.ndarray  # (H, W, 3) 8-bit
    error: PictureError | None  # of its mask and normals; None where they are the truth


class ShotPool:
    """Renders shots; a context, for its processes end with it.

    Args:
        subject: who is rendered.
        workers: processes; with 1, this process does it.
        step: called after each picture.
    """

    def __init__(self, subject: Subject, workers: int, step: Callable[[], None]) -> None:
        self._subject, self._workers, self._step = subject, workers, step
        self._held = ExitStack()
        self._pool: Executor | None = None
        self._renderer = Renderer(subject) if workers == 1 else None

    def __enter__(self) -> ShotPool:
        if self._workers > 1:
            work = processes(self._workers, _start_worker, self._subject)
            self._pool = self._held.enter_context(work)
        return self

    def __exit__(self, *error: Any) -> None:  # noqa: ANN401
        self._held.__exit__(*error)

    def render(self, shots: Iterable[Shot]) -> Iterator[ShotResult]:
        """Render some shots and write their files; the results come in the order of the shots."""
        if self._pool is None:
            for shot in shots:
                yield self._done(render_shot(self._renderer, shot))
            return
        waiting: deque[Future[ShotResult]] = deque()
        for shot in shots:  # few ahead: each holds a surface
            waiting.append(self._pool.submit(_render_in_worker, shot))
            if len(waiting) > 2 * self._workers:
                yield self._done(_result(waiting.popleft()))
        while waiting:
            yield self._done(_result(waiting.popleft()))

    def _done(self, result: ShotResult) -> ShotResult:
        self._step()
        return result


def _result(shot: Future[ShotResult]) -> ShotResult:
    """What came of a picture that another process has drawn.

    Raises:
        InputError: that process is gone.
    """
    try:
        return shot.result()
    except BrokenExecutor as error:
        raise lost(error) from None


def render_shot(renderer: Renderer, shot: Shot) -> ShotResult:
    """Render one picture and write its files."""
    light, errors = np.random.SeedSequence(shot.seed).spawn(2)
    seed = int(light.generate_state(1)[0])
    true = renderer(shot.surface, shot.camera, shot.samples, seed, shot.light)
    color, error = true.color, None
    if shot.taken is None:
        _write_true(shot.folder, shot.index, true)
    else:
        effects, noise = shot.taken.effects, shot.taken.noise
        of_sensor = np.random.default_rng(errors.spawn(3)[2])  # the others: of mask and normals
        if effects.background is not None:
            color = camera_effects.over_background(color, true.mask, effects.background)
        color = camera_effects.blur_and_noise(color, effects.blur, effects.sensor, of_sensor)
        _write_true(shot.folder / "truth", shot.index, true)
        rendered = None if shot.taken.from_files else (true.mask, true.normals)
        error = spoil_pictures(shot.folder, shot.index, noise, shot.samples, rendered)
    stored = np.round(color * 255).astype(np.uint8)
    write_image(shot.folder / "frames" / f"{shot.index:06d}.png", stored)
    return ShotResult(stored, error)


def _write_true(folder: Path, index: int, true: Rendering) -> None:
    write_image(folder / "masks" / f"{index:06d}.png", true.mask)
    write_normals(folder, index, true.normals)


_renderer: Renderer | None = None  # of a worker process


def _start_worker(subject: Subject) -> None:
    global _renderer
    _renderer = Renderer(subject)


def _render_in_worker(shot: Shot) -> ShotResult:
    return render_shot(_renderer, shot)
