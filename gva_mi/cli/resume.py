"""Resume a command that was stopped: its steps in a folder, or a folder of one file per frame.

Every file is whole or missing, and a folder's marker keeps the stamp (:mod:`gva_mi.core.stamp`) of
what its content was made of. The same command, run again, does only what is missing or was made of
something else, and ends with the bits of an uninterrupted run.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.pose import Pose
from gva_mi.core.atomic import folder_lock, holds_something, require_ours, require_writable
from gva_mi.core.console import numbered, say
from gva_mi.core.errors import InputError, expecting
from gva_mi.core.files import make_room, read_json, write_json
from gva_mi.core.stamp import is_fresh, results_version, stamp, start_folder
from gva_mi.fit.renders import CameraShot


@dataclass(frozen=True)
class Step:
    """One step of a command."""

    name: str  # one word, for the progress bar
    results: str  # whose version counts: a key of RESULTS_VERSIONS
    options: Any  # all that it depends on beside files
    reads: Sequence[Path]  # files and folders of files
    writes: Sequence[Path]  # by which its results are known to be there
    run: Callable[[bool], None]  # with: was the same step begun before?

    def stamp(self) -> str:
        """Return the stamp of all that the step depends on."""
        return stamp(self.reads, [self.name, self.options], results_version(self.results))


class StepFolder:
    """A folder of steps: ``{"source": ..., "steps": {name: {"stamp", "finished"}}}``."""

    def __init__(self, folder: Path, marker: str, source: str, overwrite: bool) -> None:
        """Start a folder, or continue one of the same ``source``, a stamp.

        Raises:
            InputError: the folder holds something else.
        """
        self._path, self._source = folder / marker, source
        self._steps: dict[str, dict[str, Any]] = {}
        if overwrite:
            make_room(folder, marker, overwrite)
        elif holds_something(folder, marker):
            require_ours(folder, marker)
            expected = "the finished steps of a command"
            found = read_json(self._path, expected)
            with expecting(self._path, expected):
                if found["source"] != source:
                    raise InputError(
                        f"{folder}: was made of another film; choose another folder, or give "
                        "--overwrite to replace it"
                    )
                self._steps = {name: dict(step) for name, step in found["steps"].items()}
        require_writable(folder)
        self._write()

    def follow(self, steps: Iterable[Step]) -> None:
        """Run the steps that are not finished, in order."""
        steps = list(steps)
        for number, step in enumerate(steps, 1):
            number_of = f"{number}/{len(steps)}"
            made_of, known = step.stamp(), self._steps.get(step.name, {})
            same, finished = known.get("stamp") == made_of, known.get("finished", False)
            if same and finished and all(path.exists() for path in step.writes):
                say(f"{number_of} {step.name}: was finished before")
                continue
            self._steps[step.name] = {"stamp": made_of, "finished": False}
            self._write()
            begin = time.perf_counter()
            with numbered(number_of):
                step.run(same and not finished)
            say(f"{number_of} {step.name}: {time.perf_counter() - begin:.0f} s")
            self._steps[step.name]["finished"] = True
            self._write()

    def _write(self) -> None:
        write_json(self._path, {"source": self._source, "steps": self._steps})


@contextmanager
def series(
    out: Path,
    marker: str,
    names: Sequence[str],
    overwrite: bool,
    about: dict[str, Any],
    made_of: str,
) -> Iterator[list[str]]:
    """Lock a folder, then start it anew or continue it; yield those of ``names`` that are missing.

    ``about`` is the content of the ``marker`` file, and ``made_of`` the stamp of all files. An
    InputError says that the folder holds something else, or all files already.
    """
    with folder_lock(out, f"gva-mi {Path(marker).stem}"):
        missing = [name for name in names if not (out / name).exists()]
        if overwrite or not missing or not is_fresh(out / marker, made_of):
            start_folder(out, marker, overwrite, about, made_of)
            missing = list(names)
        else:
            require_writable(out)
            if len(missing) < len(names):
                say(f"{out}: goes on, {len(names) - len(missing)} of {len(names)} files are there")
        yield missing


def stamp_of(avatar: Avatar, motion: Pose, shots: Iterable[CameraShot], *how: object) -> str:
    """Return the stamp of the files of a folder: one picture of a driven avatar in each.

    Without pictures there are no ``shots``; ``how`` holds other numbers, words and arrays.
    """
    inputs: list[object] = [*avatar.record().values(), *motion.to_smplx().values(), *how]
    for shot in shots:
        camera = shot.camera
        inputs += [shot.frame, camera.K, camera.T_camera_world]
        inputs += [camera.model, camera.width, camera.height]
    return stamp(inputs, version=results_version("avatar"))
