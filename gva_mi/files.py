"""Files that are read with one clear error, and written whole or not at all."""

from __future__ import annotations

import hashlib
import io
import json
import platform
import shutil
import tempfile
import zipfile
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from gva_mi.arrays import arrays_in, read_header, read_npy, require_bytes
from gva_mi.budget import Budget, Damaged, Refused
from gva_mi.errors import InputError, reason_of
from gva_mi.lock import alone_in

LARGEST_TEXT = 1 << 28  # bytes of a JSON file
PACKAGES = ("gva_mi", "torch", "drjit", "numpy")  # whose versions may change the figures


def read_arrays(
    path: Path, expected: str, only: Collection[str] | None = None
) -> dict[str, np.ndarray]:
    """All arrays of an ``.npz``, which must not hold pickled objects.

    Args:
        path: the file.
        expected: what it should hold, for the error.
        only: the names of those that are read, if they are there; None: all.

    Raises:
        InputError: there is none, or it cannot be read.
    """
    if not Path(path).is_file():
        raise InputError(f"{path}: no such file; expected {expected}")
    if not zipfile.is_zipfile(path):
        raise InputError(f"{path}: not a readable .npz, or cut short; expected {expected}")
    try:
        with zipfile.ZipFile(path) as file:
            entries = arrays_in(file, Budget(), only)
            return {key: _array(f"'{key}'", data) for key, data in entries}
    except Exception as error:  # the zip, zlib and numpy each have their own
        reason = reason_of(error)
        raise InputError(f"{path}: not a readable .npz ({reason}); expected {expected}") from None


def read_array(path: Path, mapped: bool = False) -> np.ndarray:
    """The array of a ``.npy``, which must not hold pickled objects.

    Args:
        path: of the file.
        mapped: leave it on disk until it is looked at.

    Raises:
        InputError: there is none, or it cannot be read.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; expected an array (.npy)")
    try:
        with path.open("rb") as file:
            header = read_header(file)
            if header.dtype.hasobject:
                raise Refused("pickled objects")
            left = path.stat().st_size - file.tell()
            require_bytes(header.shape, header.dtype.itemsize, left)
            if mapped:
                form = header.shape, header.order
                return np.memmap(path, header.dtype, "r", file.tell(), *form)
            return np.fromfile(file, header.dtype).reshape(header.shape, order=header.order)
    except Exception as error:
        raise InputError(f"{path}: not a readable .npy ({reason_of(error)})") from None


def _array(where: str, data: bytes) -> np.ndarray:
    """The array of a .npy in a file; ``where`` is its name there."""
    try:
        return read_npy(data)
    except Exception as error:
        raise Damaged(f"{where}: {reason_of(error)}") from None


def read_json(path: Path, expected: str) -> Any:  # noqa: ANN401
    """What a JSON file says.

    Args:
        path: the file.
        expected: what it should say, for the error.

    Raises:
        InputError: there is none, or it is no JSON, or larger than any that is written here.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; expected {expected}")
    try:
        if path.stat().st_size > LARGEST_TEXT:
            raise ValueError(f"{path.stat().st_size:,} bytes")
        return json.loads(path.read_text())
    except (OSError, ValueError, RecursionError) as error:
        reason = reason_of(error)
        raise InputError(f"{path}: not readable as JSON ({reason}); expected {expected}") from None


def says(path: Path, value: Any) -> bool:  # noqa: ANN401
    """Whether a JSON file says just this; one that is missing or cannot be read does not."""
    try:
        return read_json(path, "") == json.loads(json.dumps(value, default=str))
    except InputError:
        return False


def require_keys(path: Path, arrays: dict[str, np.ndarray], keys: tuple[str, ...]) -> None:
    """Raise an InputError that names the first missing key, and what is there instead."""
    for key in keys:
        if key not in arrays:
            found = ", ".join(sorted(arrays)) or "none"
            raise InputError(f"{path}: key '{key}' is missing; found: {found}")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """A path to write to; what was written takes the place of ``path`` once it is whole.

    Raises:
        OSError: as of a disk that is full, with the name of the file.
    """
    path = Path(path)
    unfinished = part_of(path)
    try:
        with naming(path, always=True):
            path.parent.mkdir(parents=True, exist_ok=True)
            yield unfinished
            unfinished.replace(path)
    finally:
        with suppress(OSError):
            unfinished.unlink(missing_ok=True)


def part_of(path: Path) -> Path:
    """Where a file is written before it is whole; what a killed process left is written over."""
    return path.with_name(path.name + ".part")


@contextmanager
def replacing_together(main: Path, *about: str) -> Iterator[Path]:
    """A hidden folder to write a file into, and others that are about it.

    They take their places once all of them are whole. The older ones about it go before it is
    replaced, and the new ones come after it. So whatever is about it is about the one that is
    there; a process that is killed in between leaves it alone, the old one or the new one.

    Args:
        main: the file.
        about: names of all that may be about it, beside it; one that is not written now goes too.

    Raises:
        OSError: as of a disk that is full; older files stay.
    """
    main = Path(main)
    unfinished = main.with_name(f".{main.name}.gva-mi-part")
    try:
        with naming(main):
            if unfinished.exists():  # of a process that was killed
                shutil.rmtree(unfinished)
            unfinished.mkdir(parents=True)
            yield unfinished
            for name in about:
                main.with_name(name).unlink(missing_ok=True)
            for name in (main.name, *about):
                if (unfinished / name).exists():
                    (unfinished / name).replace(main.with_name(name))
    finally:
        shutil.rmtree(unfinished, ignore_errors=True)


@contextmanager
def naming(path: Path, always: bool = False) -> Iterator[None]:
    """Whatever the disk refuses within is told with the name of a file: not every writer knows it.

    Args:
        path: the file or folder that is written.
        always: whether it takes the place of the name that an error has.
    """
    try:
        yield
    except OSError as error:
        if error.errno is None or (error.filename is not None and not always):
            raise
        raise OSError(error.errno, error.strerror, str(path)) from None


@contextmanager
def whole_folder(out: Path, replaced: str | None = None) -> Iterator[Path]:
    """A folder beside ``out`` that becomes ``out`` if all goes well, and vanishes if not.

    A process that is killed leaves its folder behind, and the next one that makes ``out`` removes
    it. Until then ``out`` is the old one or the new one, whole.

    Args:
        out: a new or an empty folder, or one that may be replaced.
        replaced: the marker of a folder that may be: see :func:`make_room`. An old one is removed
            once the new one is whole.

    Raises:
        InputError: where ``out`` already holds something, and may not be replaced; or another
            process makes it.
        OSError: as of a disk that is full, with the name of a file or the folder.
    """
    out = Path(out).absolute()
    unfinished, old = (out.with_name(f".{out.name}.gva-mi-{what}") for what in ("part", "old"))
    require_writable(out.parent)
    with alone_in(out, "gva-mi") as locked:
        if locked:
            _clear_up(out, unfinished, old)
        if _holds_something(out):
            if replaced is None or not out.is_dir():
                raise InputError(f"{out}: already there; expected a new or an empty folder")
            _require_ours(out, replaced)
        if unfinished.exists():  # where there are no locks, nobody knows whose it is
            raise InputError(
                f"{unfinished}: is there already: another process makes {out}, or one was killed "
                "while it did; remove it where none does"
            )
        try:
            with naming(out):
                unfinished.mkdir()
                yield unfinished
                if replaced is None and _holds_something(out):
                    raise InputError(
                        f"{out}: was made by another process meanwhile; nothing is replaced"
                    )
                if _holds_something(out):
                    out.rename(old)
                unfinished.rename(out)
        finally:
            for left in (unfinished, old):
                shutil.rmtree(left, ignore_errors=True)


def _clear_up(out: Path, unfinished: Path, old: Path) -> None:
    """Remove what :func:`whole_folder` left in a process that was killed."""
    if old.exists() and not out.exists():  # killed between its last two steps
        old.rename(out)
    for left in (unfinished, old):
        if left.exists():
            shutil.rmtree(left)


def require_room(path: Path, overwrite: bool) -> None:
    """Check that a file can be written, before the work whose result it is to hold.

    Raises:
        InputError: it is there and may not be replaced, or its folder takes no file.
    """
    if path.is_dir():
        raise InputError(f"{path}: is a folder; expected the name of a file")
    if path.exists() and not overwrite:
        raise InputError(f"{path}: exists already; give --overwrite to replace it")
    require_writable(path.parent)


def require_writable(folder: Path) -> None:
    """Make a folder where it is missing, and see whether it takes a file.

    Raises:
        InputError: it does not.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InputError(f"{folder}: cannot be written to ({error.strerror})") from None


def make_room(folder: Path, marker: str, overwrite: bool) -> None:
    """Make room for an output folder, but never at the cost of anything that is not ours.

    A folder that is missing or empty is left as it is. One that holds something is removed if that
    was asked for and if it holds the marker, which tells that this program made it.

    Args:
        folder: where output is to be written.
        marker: name of a file that every such output folder holds.
        overwrite: whether the folder may be replaced.

    Raises:
        InputError: the folder holds something, and may not be replaced or has no marker.
    """
    require_replaceable(folder, marker, overwrite)
    if not _holds_something(folder, marker):
        return
    for path in folder.iterdir():  # the marker last: who is killed here leaves a folder of ours
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        elif path.name != marker:
            path.unlink()
    shutil.rmtree(folder)


def require_replaceable(folder: Path, marker: str, overwrite: bool) -> None:
    """Raise what :func:`make_room` raises, and leave the folder as it is."""
    if not _holds_something(folder, marker):
        return
    if not overwrite:
        raise InputError(f"{folder}: already holds something; give --overwrite to replace it")
    _require_ours(folder, marker)


def _holds_something(folder: Path, marker: str | None = None) -> bool:
    """Whether a folder is not empty; a marker that a killed process was writing is nothing."""
    if not folder.is_dir():
        return folder.exists()
    begun = part_of(folder / marker) if marker else None
    return any(path != begun for path in folder.iterdir())


def _require_ours(folder: Path, marker: str) -> None:
    if not (folder / marker).exists():
        raise InputError(
            f"{folder}: has no {marker}, so gva-mi did not make it and will not replace it"
        )


def start_folder(folder: Path, marker: str, overwrite: bool, about: dict[str, Any]) -> None:
    """Make room for an output folder (:func:`make_room`) and put the marker into it.

    Args:
        folder, marker, overwrite: as there.
        about: what the marker says, beside the versions.

    Raises:
        InputError: as there, or the folder cannot be written to.
    """
    make_room(folder, marker, overwrite)
    require_writable(folder)
    write_json(folder / marker, about | {"versions": versions()})


def write_arrays(path: Path, **arrays: np.ndarray) -> None:
    """Write an ``.npz``, packed: most of an avatar's blend shapes and skinning weights are zero."""
    whole = io.BytesIO()  # a disk that fills up is one error then, and not those of a zip as well
    np.savez_compressed(whole, **arrays)
    with replacing(path) as unfinished:
        unfinished.write_bytes(whole.getbuffer())


def write_json(path: Path, value: Any) -> None:  # noqa: ANN401 (anything that JSON can say)
    """Write JSON, indented for people; a path counts as its text."""
    with replacing(path) as unfinished:
        unfinished.write_text(json.dumps(value, indent=2, default=str) + "\n")


def versions() -> dict[str, str]:
    """Of Python and of the packages that may change the figures: written beside every result."""
    found = {"python": platform.python_version()}
    return found | {name: metadata.version(name) for name in PACKAGES}


def program_digest() -> str:
    """A digest of every line of this program: what was computed by another one may differ."""
    digest = hashlib.sha256()
    for package in ("gva_mi", "gva_mi_plugins"):
        for root in find_spec(package).submodule_search_locations:
            for file in sorted(Path(root).rglob("*.py")):
                digest.update(file.read_bytes())
    return digest.hexdigest()[:16]
