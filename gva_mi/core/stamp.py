"""Whether a result is still valid: a stamp of all that it depends on, kept in its folder's record.

::

    stamp = hash(content of the inputs, options, version)

A result is used again only if the stamp in its record equals the stamp of today. Steps of a
command, renders, runs, checkpoints and studies all decide in this way.

The version is a number that is raised by hand when the same inputs and options give another result
(:data:`RESULTS_VERSIONS`), and not a hash of the program. A hash of the source files makes every
result stale with every comment; a hash without comments does so with every new name. A study takes
days of computing. The ledger (``tests/core/ledger``) detects changed bits, and asks for a higher
number. Versions of numerical libraries may change last digits. So they count too where all files of
a folder should come from the same versions (:func:`results_version`).

Example:
    >>> stamp([np.zeros(3)], options={"steps": 10}) == stamp([np.zeros(3)], options={"steps": 10})
    True
    >>> stamp([np.zeros(3)], options={"steps": 10}) == stamp([np.ones(3)], options={"steps": 10})
    False

The record of an output folder is a JSON file that says what made it: options, seed, versions of the
libraries, and the stamp where there is one.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import platform
from collections.abc import Iterable, Iterator
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.core.atomic import require_writable
from gva_mi.core.errors import InputError
from gva_mi.core.files import make_room, read_json, write_json

# Raise the number when the same inputs and options give other results than before: "video" of the
# masks and poses of stage 1 from a video, and of what stage 2 knows of their errors; "refine" of
# the poses of stage 2 from the same knowledge; "avatar" of a fit, its evaluation and its pictures.
RESULTS_VERSIONS = {"video": 19, "refine": 16, "avatar": 16}
LIBRARIES = ("torch", "drjit", "mitsuba", "numpy")  # whose versions may change last digits
STAMP, STAMP_BYTES = "stamp", 32  # its name in a record, and its length as text
_BLOCK = 1 << 20  # bytes read at once; chosen: a megabyte, little memory and few calls


def stamp(inputs: Iterable[object] = (), options: object = None, version: object = None) -> str:
    """Return a hash of all that a result depends on.

    Args:
        inputs: a path stands for the content of a file, or of all files in a folder; everything
            else is hashed as an array: numbers, text, arrays of numpy and tensors.
        options: anything that JSON can hold, dataclasses and paths.
        version: a number of :data:`RESULTS_VERSIONS`, or :func:`results_version`.
    """
    plain = lambda x: dataclasses.asdict(x) if dataclasses.is_dataclass(x) else str(x)
    total = hashlib.blake2b(digest_size=16)
    total.update(json.dumps([options, version], default=plain, sort_keys=True).encode())
    for value in inputs:
        for part in _bytes_of_path(value) if isinstance(value, Path) else _bytes_of_array(value):
            total.update(part)
    return total.hexdigest()


def is_fresh(record: Path, stamp: str) -> bool:
    """Return whether a folder's record holds this stamp; False if it cannot be read."""
    try:
        found = read_json(record, "a record of what made this folder")
    except InputError:
        return False
    return isinstance(found, dict) and found.get(STAMP) == stamp


def write_record(path: Path, about: dict[str, Any], stamp: str | None = None) -> None:
    """Write the record of an output folder: ``about`` it, the versions, and its stamp if any."""
    write_json(path, about | {"versions": versions()} | ({STAMP: stamp} if stamp else {}))


def start_folder(
    folder: Path, marker: str, overwrite: bool, about: dict[str, Any], stamp: str | None = None
) -> None:
    """Make room for an output folder, and write its record as its marker."""
    make_room(folder, marker, overwrite)
    require_writable(folder)
    write_record(folder / marker, about, stamp)


def versions() -> dict[str, str]:
    """Return the versions of Python, this package and :data:`LIBRARIES` for a record."""
    ours = {"python": platform.python_version(), "gva_mi": metadata.version("gva_mi")}
    return ours | _libraries()


def results_version(kind: str) -> dict[str, object]:
    """Return the version of results of one kind, and the versions of the libraries."""
    return {kind: RESULTS_VERSIONS[kind]} | _libraries()


def _libraries() -> dict[str, str]:
    found = {}
    for name in LIBRARIES:
        with suppress(metadata.PackageNotFoundError):  # splatting needs no Mitsuba
            found[name] = metadata.version(name)
    return found


def _bytes_of_path(path: Path) -> Iterator[bytes]:
    """Yield names and content of a file, or of a folder's files; for a missing file its name."""
    files = sorted(x for x in path.rglob("[!.]*") if x.is_file()) if path.is_dir() else [path]
    for file in files:
        size = file.stat().st_size if file.exists() else -1
        yield f"{path.name}/{file.relative_to(path)}:{size}\n".encode()
        if size > 0:
            with file.open("rb") as stream:
                while block := stream.read(_BLOCK):
                    yield block


def _bytes_of_array(value: object) -> Iterator[bytes]:
    """Yield shape, dtype and numbers."""
    array = np.asarray(value)
    yield f"{array.shape}:{array.dtype}\n".encode()
    yield np.ascontiguousarray(array).tobytes()
