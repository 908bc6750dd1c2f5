"""Read arrays and JSON with one clear error; name files of other kinds; make room for output."""

from __future__ import annotations

import io
import json
import os
import shutil
import zipfile
from collections.abc import Callable, Collection, Hashable, Sequence
from functools import lru_cache, wraps
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from gva_mi.core.atomic import (
    atomic_write,
    holds_something,
    link_target,
    require_ours,
    require_writable,
    write_bytes,
)
from gva_mi.core.errors import InputError, is_memory, reason_of

T = TypeVar("T")
Form = tuple[int | None, ...]  # of an array: the length of each axis, None for any
# Bytes of a JSON file. Chosen: 256 MB; parsed, a larger one would not fit into memory.
LARGEST_JSON = 1 << 28


def require_file(path: Path, expected: str) -> None:
    """Raise an InputError unless a path is a file; ``expected`` says what it should hold.

    A pipe would be waited for, and a device may never end.
    """
    path = Path(path)
    if path.parent.is_file():
        raise InputError(f"{path.parent}: is a file; expected a folder with {path.name}")
    if not path.is_file():
        kind = "is a device or a pipe" if path.exists() else "no such file"
        kind = "is a folder" if path.is_dir() else kind
        raise InputError(f"{path}: {kind}; expected {expected}")


def read_arrays(
    path: Path, expected: str, only: Collection[str] | None = None
) -> dict[str, np.ndarray]:
    """Read the arrays of an ``.npz``, or of ``only`` some of them; pickled objects are refused.

    ``expected`` says in the InputError what the file should hold.
    """
    require_file(path, expected)
    if not zipfile.is_zipfile(path):
        kind = known_container(path) or "not a readable .npz, or cut short"
        raise InputError(f"{path}: {kind}; expected {expected}")
    found, name = {}, ""
    try:
        with np.load(path, allow_pickle=False) as file:
            for name in file.files:
                if name in only if only is not None else Path(name).name[0] != ".":
                    found[name] = file[name]
        if not all(isinstance(x, np.ndarray) for x in found.values()):
            raise ValueError("it is not an array of numpy")
    except Exception as error:  # zipfile, zlib and numpy each raise their own
        reason = f"'{name}': {reason_of_read(error)}"
        raise InputError(f"{path}: not a readable .npz ({reason}); expected {expected}") from None
    return found


def read_array(path: Path, mapped: bool = False) -> np.ndarray:
    """Read a ``.npy``; pickled objects are refused. A ``mapped`` one is read on access."""
    require_file(path, "an array (.npy)")
    try:
        with Path(path).open("rb") as file:
            np.lib.format.read_magic(file)  # np.load opens archives, too
        return np.load(path, mmap_mode="r" if mapped else None, allow_pickle=False)
    except Exception as error:
        raise InputError(f"{path}: not a readable .npy ({reason_of_read(error)})") from None


def reason_of_read(error: Exception) -> str:
    """Return in plain words why the arrays of a file could not be read."""
    if "allow_pickle" in str(error):
        return "pickled objects"
    return "it claims more than there is memory" if is_memory(error) else reason_of(error)


def read_bytes(path: Path, expected: str) -> bytes:
    """Read a whole file; ``expected`` says in the InputError what it should hold."""
    require_file(path, expected)
    try:
        return Path(path).read_bytes()
    except OSError as error:
        reason = error.strerror
        raise InputError(f"{path}: cannot be read ({reason}); expected {expected}") from None


def read_json(path: Path, expected: str) -> Any:  # noqa: ANN401
    """Read a JSON file; ``expected`` says in the InputError what it should hold."""
    path = Path(path)
    require_file(path, expected)
    try:
        if path.stat().st_size > LARGEST_JSON:
            raise ValueError(f"{path.stat().st_size:,} bytes")
        return json.loads(path.read_text("utf-8-sig"))  # with or without a byte-order mark
    except (OSError, ValueError, RecursionError) as error:
        reason = reason_of(error)
        raise InputError(f"{path}: not readable as JSON ({reason}); expected {expected}") from None


def once_a_file(read: Callable[..., T]) -> Callable[..., T]:
    """Wrap ``read(path, ...)`` so that a process reads a file again only when it has changed.

    A change of other files in its folder counts, too. Arguments and results of ``read`` have to be
    small and hashable. Errors are not kept.
    """
    kept = lru_cache(maxsize=1 << 16)(lambda stamp, *given: read(*given))

    @wraps(read)
    def of(path: Path, *given: Hashable) -> T:
        if not path.is_file():
            return read(path, *given)
        file, folder = path.stat(), path.parent.stat()
        return kept((file.st_ino, file.st_size, file.st_mtime_ns, folder.st_mtime_ns), path, *given)

    return of


def require_keys(path: Path, arrays: dict[str, np.ndarray], keys: tuple[str, ...]) -> None:
    """Raise an InputError that names the first missing key, and the keys that were found."""
    for key in keys:
        if key not in arrays:
            found = ", ".join(sorted(arrays)) or "none"
            raise InputError(f"{path}: key '{key}' is missing; found: {found}")


def shape_fault(shape: Sequence[int], *forms: Form) -> str | None:
    """Return why a shape fits none of ``forms``; None if it fits one, or if none are given.

    Example:
        >>> shape_fault((500, 2), (None, 3))
        'must be (*, 3), got (500, 2)'
    """
    for form in forms:
        lengths = zip(form, shape, strict=False)
        if len(form) == len(shape) and all(want in (None, got) for want, got in lengths):
            return None
    said = " or ".join(str(form).replace("None", "*") for form in forms)
    return f"must be {said}, got {tuple(shape)}" if forms else None


_KINDS = {"f": "floating point", "iu": "whole numbers", "iuf": "numbers"}  # of a dtype


def require_array(
    path: Path,
    name: str,
    array: np.ndarray,
    *forms: Form,
    kind: str = "f",
    largest: float | None = None,
) -> np.ndarray:
    """Return an array of a file, or raise an InputError that says what it should be.

    Args:
        path: the file.
        name: the array's name.
        array: as it was read. Floating point other than 32 or 64 bits becomes 64 bits, because
            linear algebra supports only these.
        forms: its possible shapes; none: any.
        kind: the kind of its dtype, a key of ``_KINDS``.
        largest: the largest absolute value that is allowed, which makes all numbers finite; None:
            any.
    """
    if array.dtype.kind not in kind:
        raise InputError(f"{path}: '{name}' must be {_KINDS[kind]}, got {array.dtype}")
    if fault := shape_fault(array.shape, *forms):
        raise InputError(f"{path}: '{name}' {fault}")
    if array.dtype.kind == "f" and array.dtype.itemsize not in (4, 8):
        array = array.astype(np.float64)
    if largest is not None and not (fine := np.abs(array) <= largest).all():
        at = np.argwhere(~fine)[0].tolist()
        where = f" at {at}" if at else ""
        raise InputError(
            f"{path}: '{name}' holds {array[tuple(at)]:.3g}{where}, expected finite numbers of at "
            f"most {largest:,.10g}"
        )
    return array


def require_room(path: Path, overwrite: bool) -> None:
    """Raise an InputError if a file cannot be written; called before the work starts.

    Nothing is created: its writer makes the folder, once the input is known to be good.
    """
    path = link_target(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder; expected the name of a file")
    if path.exists() and not path.is_file():
        raise InputError(f"{path}: is a device or a pipe; expected the name of a file")
    if path.exists() and not overwrite:
        raise InputError(f"{path}: exists already; give --overwrite to replace it")
    folder = Path(os.path.realpath(path.parent))
    require_writable(next(x for x in (folder, *folder.parents) if x.exists()))


def make_room(folder: Path, marker: str, overwrite: bool) -> None:
    """Remove an output folder that may be replaced; a missing or empty one is left as it is.

    A folder without the file ``marker`` was not made by this program, and is not replaced.
    """
    require_replaceable(folder, marker, overwrite)
    folder = link_target(folder)
    if not holds_something(folder, marker):
        return
    for path in folder.iterdir():  # the marker last, so that a killed process leaves our folder
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        elif path.name != marker:
            path.unlink()
    shutil.rmtree(folder)


def require_replaceable(folder: Path, marker: str, overwrite: bool) -> None:
    """Raise what :func:`make_room` raises, and leave the folder as it is."""
    if not holds_something(folder, marker):
        return
    if not overwrite:
        raise InputError(f"{folder}: already holds something; give --overwrite to replace it")
    require_ours(folder, marker)


def write_arrays(path: Path, **arrays: np.ndarray) -> None:
    """Write a compressed ``.npz``: most blend shapes and skinning weights are zero."""
    whole = io.BytesIO()  # in memory, so that a full disk is one error and not the zip's as well
    np.savez_compressed(whole, **arrays)
    write_bytes(path, whole.getbuffer())


def write_json(path: Path, value: Any) -> None:  # noqa: ANN401
    """Write indented JSON; a path is written as its text."""
    with atomic_write(path) as unfinished:
        unfinished.write_text(json.dumps(value, indent=2, default=str) + "\n")


# Formats that are not read here, and how to convert them, by the first bytes of a file.
_BEGINNINGS = {
    b"glTF": "a .glb, a scene: export its skeleton's motion as .bvh",
    b"NGSP": "an .spz of Gaussians, of a version without gzip: save them as .ply",
    b"\x1f\x8b": "compressed by gzip, such as an .spz of Gaussians: save them as .ply",
    b"ply": "a .ply of points, a mesh or Gaussians",
    b"version https://git-lfs": "a Git LFS pointer instead of the file: git lfs pull fetches it",
    b"<!DOCTYPE": "a web page, such as of a download that asks for an account",
    b"<!doctype": "a web page, such as of a download that asks for an account",
    b"Kaydara FBX": "an .fbx, a scene: export its skeleton's motion as .bvh",
    b"HIERARCHY": "a .bvh, the motion of a skeleton of its own",
    b"\x89HDF": "an HDF5 file (.h5, .hdf5, .mat of version 7.3): save its arrays as .npz",
    b"MATLAB 5.0": "a .mat: scipy.io.loadmat reads it, numpy.savez saves its arrays",
}


def known_container(path: Path) -> str | None:
    """Name an unsupported container format and how to convert it, or return None."""
    try:
        with path.open("rb") as file:
            start = file.read(1 << 16)
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    if b"KHR_gaussian_splatting" in start:  # in the JSON of a .glb or .gltf
        return "Gaussians by glTF's KHR_gaussian_splatting"
    return next((text for known, text in _BEGINNINGS.items() if start.startswith(known)), None)
