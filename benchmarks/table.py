"""Measure what people wait for: the renderer, a step of the fit, ``demo``, ``avatar``, ``batch``.

Each command runs in a process of its own. The video of ``avatar`` is rendered; ``batch`` makes
drafts of two copies of it, with one worker and with two. CPU is that of all processes.
"""

from __future__ import annotations

import io
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from benchmarks import fit
from benchmarks.splat import Work, person
from benchmarks.timing import Table, timed
from gva_mi.app import pipeline
from gva_mi.body.smplx import load_body
from gva_mi.core.tasks import worker_processes
from gva_mi.synthetic import SynthOptions, make_subject
from gva_mi.synthetic.pictures.cameras import PHONE_VIDEO

# The functions of gva_mi.app.pipeline that are steps of its commands.
STEPS = ("make_subject", "prepare", "check", "refine", "fit", "evaluate", "write_avatar_report")
BATCH_WORKERS = (1, 2)


@dataclass(frozen=True)
class Sizes:
    """How much is measured; chosen so that all of it takes some ten minutes on two cores."""

    gaussians: tuple[int, ...] = (20_000, 100_000)
    pixels: int = 512  # a side of the renderer's pictures and of the video's
    frames: int = 24  # of the video
    demo: pipeline.DemoOptions = pipeline.DemoOptions()
    effort: pipeline.AvatarEffort = pipeline.AvatarEffort()


def run(
    repeats: int,
    video: Path | None = None,
    sizes: Sizes = Sizes(),  # noqa: B008 (frozen)
) -> Iterator[Table]:
    """Yield all tables.

    Args:
        repeats: calls per figure of the renderer and of the fit.
        video: to make an avatar of; None: a rendered one.
        sizes: of everything else.
    """
    scenes = {n: Work.on(person(n, sizes.pixels)) for n in sizes.gaussians}
    rows = [{"Gaussians": n} | timed(work.both, repeats).columns for n, work in scenes.items()]
    yield Table(f"forward and backward, {sizes.pixels} x {sizes.pixels} pixels, SH 3", rows)
    yield from islice(fit.run(repeats, sizes.gaussians[0], sizes.pixels), 2)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        yield _steps_of("demo", sizes.demo.frames, folder / "demo", sizes.demo)
        if video is None:
            options = SynthOptions(
                frames=sizes.frames, size=sizes.pixels, scene="room", error_model="none",
                novel_poses=0, novel_views=0, workers=os.cpu_count() or 1,
            )  # fmt: skip
            make_subject(folder / "filmed", options, load_body())
            video = folder / "filmed" / PHONE_VIDEO
        given = video, folder / "avatar"
        yield _steps_of("avatar", sizes.frames, *given, effort=sizes.effort)
        yield _batch(video, folder)


def _steps_of(command: str, frames: int, *given: Any, **named: Any) -> Table:  # noqa: ANN401
    """Time the steps of a command of :mod:`gva_mi.app.pipeline` in a new process."""
    with worker_processes(1, int) as pool:
        rows = pool.submit(_timed_steps, command, given, named).result()
    for row in rows:
        row["CPU s a frame"] = row["CPU s"] / frames
    return Table(f"gva-mi {command}, {frames} frames", rows)


def _timed_steps(
    command: str, given: tuple[Any, ...], named: dict[str, Any]
) -> list[dict[str, str | float]]:
    """Run a command and return a row for each of its steps, and for all of it."""
    rows = []

    def counted(name: str, work: Callable[..., Any]) -> Callable[..., Any]:
        def step(*args: Any, **options: Any) -> Any:  # noqa: ANN401
            wall, cpu = time.perf_counter(), _cpu()
            result = work(*args, **options)
            row = {"step": name, "wall s": time.perf_counter() - wall, "CPU s": _cpu() - cpu}
            rows.append(row | {"cores": row["CPU s"] / row["wall s"]})
            return result

        return step

    whole = counted("all", getattr(pipeline, command))
    for name in STEPS:
        setattr(pipeline, name, counted(name, getattr(pipeline, name)))
    with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
        whole(*given, **named)
    return rows


def _cpu() -> float:
    """Return the CPU seconds of this process and of all that ended in it."""
    return sum(os.times()[:4])


def _batch(video: Path, folder: Path) -> Table:
    """Time ``gva-mi batch`` of two copies of a video."""
    copies = [shutil.copyfile(video, folder / f"{name}{video.suffix}") for name in ("a", "b")]
    rows = []
    for workers in BATCH_WORKERS:
        out, begin = folder / f"batch{workers}", time.perf_counter()
        command = ["batch", *copies, "--out", out, "--quality", "draft", "--workers", workers]
        subprocess.run(
            [sys.executable, "-m", "gva_mi", *map(str, command)], check=True, capture_output=True
        )
        rows.append({"workers": workers, "wall s": time.perf_counter() - begin})
    for row in rows:
        row["times as fast"] = rows[0]["wall s"] / row["wall s"]
    return Table("gva-mi batch, 2 drafts", rows)
