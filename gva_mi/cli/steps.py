"""Run the steps of one command in a folder, so that a finished step is not repeated.

The folder's marker keeps a hash of everything that each finished step depends on: its options, the
files it reads, and this program. The same command, run again, runs only the steps whose hash is
another one, or whose results are gone. A killed process loses at most the step that was running.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gva_mi.core.atomic import holds_something, require_ours, require_writable
from gva_mi.core.console import numbered, say
from gva_mi.core.errors import InputError, expecting
from gva_mi.core.files import make_room, read_json, write_json
from gva_mi.core.provenance import hash_arrays, hash_files, program_digest, versions


@dataclass(frozen=True)
class Step:
    """One step of a command."""

    name: str  # one word, for the progress bar
    options: Any  # all that it depends on beside files; anything with a text
    reads: Sequence[Path]  # files and folders of files
    writes: Sequence[Path]  # by which its results are known to be there
    run: Callable[[bool], None]  # with: was the same step begun before?

    def made_of(self) -> str:
        """Return a hash of all that the step depends on."""
        files = [file for path in self.reads for file in _files(path)]
        about = json.dumps([self.name, self.options, versions()], default=str, sort_keys=True)
        return hash_arrays((program_digest(), about, hash_files(files)))


class StepFolder:
    """A folder of steps: ``{"source": ..., "begun": {...}, "finished": {...}}`` in its marker."""

    def __init__(self, folder: Path, marker: str, source: str, overwrite: bool) -> None:
        """Start a folder, or continue one that was made of the same ``source``, a hash.

        Raises:
            InputError: the folder holds something else.
        """
        self._path = folder / marker
        self._record: dict[str, Any] = {"source": source, "begun": {}, "finished": {}}
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
                for name in ("begun", "finished"):
                    self._record[name] = {str(k): str(v) for k, v in found[name].items()}
        require_writable(folder)
        self._write()

    def follow(self, steps: Iterable[Step]) -> None:
        """Run the steps that are not finished, in order."""
        steps = list(steps)
        for number, step in enumerate(steps, 1):
            made_of = step.made_of()
            there = all(path.exists() for path in step.writes)
            if there and self._record["finished"].get(step.name) == made_of:
                say(f"{number}/{len(steps)} {step.name}: was finished before")
                continue
            again = self._record["begun"].get(step.name) == made_of
            self._record["finished"].pop(step.name, None)
            self._record["begun"][step.name] = made_of
            self._write()
            begin, busy = time.perf_counter(), _cpu_seconds()
            with numbered(f"{number}/{len(steps)}"):
                step.run(again)
            took, busy = time.perf_counter() - begin, _cpu_seconds() - busy
            say(f"{number}/{len(steps)} {step.name}: {took:.0f} s, {busy:.0f} s of CPU")
            del self._record["begun"][step.name]
            self._record["finished"][step.name] = made_of
            self._write()

    def _write(self) -> None:
        write_json(self._path, self._record)


def _cpu_seconds() -> float:
    """Return the CPU time of this process and of its finished workers, seconds."""
    return sum(os.times()[:4])


def _files(path: Path) -> list[Path]:
    """Return a file, or the files of a folder; none if it is missing."""
    if path.is_dir():
        return sorted(file for file in path.rglob("*") if file.is_file())
    return [path] if path.exists() else []
