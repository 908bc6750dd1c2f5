"""Open what a user names as a source: a file of another program, or a folder of such files.

:func:`read_source` returns the content of a file and the path of a folder. The other functions look
at what was found, so that a reader can recognise its program. Nothing in a file is executed.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.core.errors import InputError
from gva_mi.core.pickles import read_objects
from gva_mi.readers.body_arrays import listed_names, one_object

_SUFFIXES = (".pkl", ".pickle", ".npz", ".npy", ".pt")  # of files that read_objects opens


def read_source(source: Path, expected: str = "what a pose estimator wrote") -> Any:  # noqa: ANN401
    """Read a file's content; for a folder, return its path. A list becomes a dictionary."""
    found = source if source.is_dir() else one_object(read_objects(source, expected))
    several = isinstance(found, list) or (isinstance(found, np.ndarray) and found.dtype.hasobject)
    return dict(enumerate(found)) if several else found


def read_named(path: Path, expected: str) -> dict:
    """Read a file's content as a dictionary."""
    found = read_source(path, expected)
    if not isinstance(found, dict):
        raise InputError(
            f"{path}: holds {contents(found)}, not arrays by name; expected {expected}"
        )
    return found


def files_in(found: Any, pattern: str = "[!.]*") -> list[Path]:  # noqa: ANN401
    """Return a folder's files of a pattern, sorted by name; by default, all but hidden ones."""
    paths = found.glob(pattern) if isinstance(found, Path) else ()
    return sorted(path for path in paths if path.suffix in _SUFFIXES)


def first_of(found: Any) -> Any:  # noqa: ANN401
    """Return the content of a folder's first file, or of a file that is already read."""
    if not isinstance(found, Path):
        return found
    files = files_in(found)
    try:
        return read_source(files[0]) if files else None
    except InputError:
        return None


def holds(found: Any, *names: str) -> bool:  # noqa: ANN401
    """Whether a file's content is a dictionary with all these names; "a|b" means a or b."""
    return isinstance(found, Mapping) and all(
        any(name in found for name in either.split("|")) for either in names
    )


def has_one(found: Any, *names: str) -> bool:  # noqa: ANN401
    """Whether one of a file's dictionaries has all these names, the first of them not None."""
    whole = isinstance(found, Mapping)
    return whole and any(holds(x, *names) and x[names[0]] is not None for x in found.values())


def contents(found: Any) -> str:  # noqa: ANN401
    """Describe in a few words what a file or a folder holds."""
    if isinstance(found, Path):
        return f"files such as {listed_names(sorted(x.name for x in found.glob('[!.]*'))[:4])}"
    if isinstance(found, Mapping):
        return listed_names([f"{name!s:.40}" for name in found]) or "nothing"
    shape = f" {found.shape}" if isinstance(found, np.ndarray) else ""
    return f"one {type(found).__name__}{shape} without names"
