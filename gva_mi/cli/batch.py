"""The command ``gva-mi batch``: an avatar of each of many videos, on one machine or on a cluster.

::

    out/
      NAME/        the avatar of NAME.mp4, as `gva-mi avatar` writes it
      NAME.log     what it printed
      batch.csv    a row for each video: figures, minutes, or why it failed
      batch.html   the same as a page, with a picture of each avatar
      batch.json   marks the folder, and holds the versions

The videos are tasks of dask.distributed (:func:`gva_mi.core.tasks.cluster`). A task runs `gva-mi
avatar` in a process of its own, so a crash stops no other video, and its log holds the command. The
process ends if its worker is killed; the scheduler then gives the task to another worker, which
continues from the finished steps.
"""

from __future__ import annotations

import csv
import io
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from gva_mi.app import AvatarEffort
from gva_mi.app.pipeline import RUN
from gva_mi.cli.parse import Flat, Switch, given
from gva_mi.core.atomic import folder_lock, require_writable, write_bytes
from gva_mi.core.console import say
from gva_mi.core.errors import InputError, reason_of
from gva_mi.core.options import Workers
from gva_mi.core.stamp import start_folder, versions
from gva_mi.core.tasks import cluster, end_with_input
from gva_mi.evaluate.figures import Table, text_of, where
from gva_mi.evaluate.measure import Metrics
from gva_mi.evaluate.page import Picture, Section, picture, write_page
from gva_mi.evaluate.report import TURNTABLE
from gva_mi.stage1.prepare import PrepareVideoOptions
from gva_mi.subject.video_file import VideoFile

MARKER, TABLE, PAGE = "batch.json", "batch.csv", "batch.html"
COLUMNS = ("video", "PSNR, dB", "person's box, dB", "Gaussians", "minutes", "failure")
SET_BY_DASK = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")  # to 1 in workers
FAILED = 1  # exit code, if a video failed
COMPLAINT = "gva-mi: "  # begins the sentence of a command that fails


@dataclass(frozen=True)
class Made:
    """How the command for one video ended."""

    name: str
    seconds: float
    failure: str = ""  # a sentence; empty: the avatar is finished


def batch(
    videos: Positional[tuple[Path, ...]],
    video_options: Flat[PrepareVideoOptions] = PrepareVideoOptions(),  # noqa: B008 (frozen)
    effort: Flat[AvatarEffort] = AvatarEffort(),  # noqa: B008 (frozen)
    *,
    out: Path,
    workers: Workers = 1,
    scheduler: str | None = None,
    overwrite: Switch = False,
) -> None:
    """Make an avatar of each video: `gva-mi avatar` for many, on this machine or on a cluster.

    A video that fails does not stop the others. The same command resumes what was interrupted or
    failed, and gives the same bits. The exit code is 1 if a video failed.

    Args:
        videos: files or folders of pictures, as `gva-mi avatar` takes; each shows one person.
        video_options: what is known about all of them.
        effort: how much work is spent on each.
        out: folder for the avatars (out/NAME) and the table (out/batch.html).
        workers: videos at a time on this machine; each takes two gigabytes or more.
        scheduler: address of a dask.distributed scheduler, such as tcp://10.0.0.1:8786, whose
            workers make the avatars instead. All machines must see the videos and this folder under
            the same paths.
        overwrite: make all avatars anew.
    """
    names = _names(videos)
    if not (out / MARKER).exists():
        start_folder(out, MARKER, overwrite, {})
    require_writable(out)
    given_options = [*_arguments(video_options), *_arguments(effort)]
    given_options += ["--overwrite"] * overwrite
    found: list[Made] = []
    with folder_lock(out, "gva-mi batch"), cluster(scheduler, workers, versions) as client:
        from distributed import as_completed

        tasks = [
            client.submit(make, video.resolve(), out.resolve() / name, given_options, pure=False)
            for name, video in names.items()
        ]
        of_task = dict(zip((task.key for task in tasks), names, strict=True))
        for task in as_completed(tasks):
            try:
                made = task.result()
            except Exception as error:  # of the cluster: workers were killed again and again
                made = Made(of_task[task.key], 0, f"the cluster lost it ({reason_of(error)})")
            found.append(made)
            ends = made.failure or f"{made.seconds / 60:.1f} minutes"
            say(f"{len(found)}/{len(names)} {made.name}: {ends}")
        write_table(out, sorted(found, key=lambda made: list(names).index(made.name)))
    say(f"table: {out / TABLE}; page: {out / PAGE}")
    if any(made.failure for made in found):
        sys.exit(FAILED)


def _names(videos: Sequence[Path]) -> dict[str, Path]:
    """Return the videos by the names of their avatars' folders."""
    names: dict[str, Path] = {}
    for video in videos:
        name = video.name if video.is_dir() else video.stem
        if name in names:
            raise InputError(
                f"batch: several videos have the name {name}; each avatar gets a folder of its "
                "video's name, so rename one, or give them to two commands"
            )
        names[name] = video
    return names


def _arguments(options: object) -> Iterator[str]:
    """Yield options that differ from the defaults as arguments of a command."""
    for name, flag in given(options).items():
        value = getattr(options, name)
        if isinstance(value, bool):
            yield flag if value else f"--no-{flag[2:]}"
        else:
            yield from (flag, *map(str, value if isinstance(value, tuple) else (value,)))


def make(video: Path, out: Path, arguments: Sequence[str]) -> Made:
    """Run `gva-mi avatar` for one video in a process of its own, and wait for it.

    Args:
        video: the file, or folder of pictures.
        out: the avatar's folder; its log is beside it.
        arguments: further ones of the command.
    """
    begin, log = time.perf_counter(), out.with_name(out.name + ".log")
    program = f"from {__name__} import {run_and_end_with_input.__name__} as run; run()"
    command = ["avatar", str(video), "--out", str(out), *arguments]
    if not (out.parent / MARKER).exists():
        return Made(out.name, 0, f"{out.parent}: this worker does not see the folder")
    own = {name: x for name, x in os.environ.items() if name not in SET_BY_DASK}
    with log.open("w") as said:
        said.write(f"gva-mi {' '.join(command)}\n")
        said.flush()
        ended = subprocess.Popen(
            [sys.executable, "-c", program, *command],
            stdin=subprocess.PIPE, stdout=said, stderr=subprocess.STDOUT, env=own,
        )  # fmt: skip
        code = ended.wait()  # its input stays open as long as this process lives
    seconds = time.perf_counter() - begin
    if code == 0:
        return Made(out.name, seconds)
    lines = [x for x in log.read_text(errors="replace").splitlines() if x.startswith(COMPLAINT)]
    usual = f"ended with exit code {code}, perhaps for lack of memory; see {log.name}"
    return Made(out.name, seconds, lines[-1].removeprefix(COMPLAINT) if lines else usual)


def run_and_end_with_input() -> None:
    """Run the command of this process, and end when the process that started it ends."""
    from gva_mi.__main__ import run

    end_with_input()
    run()


def write_table(out: Path, found: Sequence[Made]) -> None:
    """Write the table of all videos, and its page with a picture of each avatar."""
    rows, pictures = [], []
    for made in found:
        figures = [""] * 3
        if not made.failure:
            figures = _figures(out / made.name / RUN)
            pictures.append(_thumbnail(out / made.name, made.name))
        rows.append((made.name, *figures, f"{made.seconds / 60:.1f}", made.failure))
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([COLUMNS, *rows])
    write_bytes(out / TABLE, text.getvalue().encode())
    failed = sum(bool(made.failure) for made in found)
    write_page(
        out / PAGE,
        title=f"{len(found)} videos",
        subtitle=f"{len(found) - failed} avatars; {failed} videos failed.",
        sections=[
            *([Section("The avatars", pictures, columns=6)] if pictures else []),
            Section("All videos", tables=[Table(COLUMNS, rows, words=True)]),
        ],
        settings={"versions": versions()},
    )


def _figures(run: Path) -> list[str]:
    """Return the PSNR of test frames, whole and in the person's box, and how many Gaussians."""
    figures, test = Metrics.load(run).figures, {"split": "test", "alignment": ""}
    chosen = [
        where(figures, metric="PSNR, dB", region="white", **test),
        where(figures, metric="PSNR, dB", region="person", **test),
        where(figures, metric="Gaussians"),
    ]
    return [text_of(one[0].value, one[0].metric) if one else "" for one in chosen]


def _thumbnail(folder: Path, name: str) -> Picture:
    return picture(name, VideoFile(folder / f"{TURNTABLE}.mp4")[0])
