"""Provenance of a result: versions, a digest of this program, hashes of files and arrays."""

from __future__ import annotations

import functools
import hashlib
import platform
from collections.abc import Iterable
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

import numpy as np

PACKAGES = ("gva_mi", "torch", "drjit", "numpy")  # whose versions may change results
_BLOCK = 1 << 20  # bytes read at once


def versions() -> dict[str, str]:
    """Return the versions of Python and :data:`PACKAGES`, which every result records."""
    found = {"python": platform.python_version()}
    return found | {name: metadata.version(name) for name in PACKAGES}


@functools.cache
def program_digest() -> str:
    """Return a digest of this program's source files."""
    digest = hashlib.sha256()
    for package in ("gva_mi", "gva_mi_plugins"):
        for root in find_spec(package).submodule_search_locations:
            for file in sorted(Path(root).rglob("*.py")):
                digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def hash_files(paths: Iterable[Path]) -> str:
    """Return a hash of files: their names, their content and their order."""
    total = hashlib.blake2b(digest_size=16)
    for path in paths:
        total.update(f"{path.name}:{path.stat().st_size}\n".encode())
        with path.open("rb") as file:
            while block := file.read(_BLOCK):
                total.update(block)
    return total.hexdigest()


def hash_arrays(arrays: Iterable[object]) -> str:
    """Return a hash of numbers or strings: their values, shapes and dtypes."""
    total = hashlib.blake2b(digest_size=16)
    for array in map(np.asarray, arrays):
        total.update(f"{array.shape}:{array.dtype}\n".encode())
        total.update(np.ascontiguousarray(array).tobytes())
    return total.hexdigest()
