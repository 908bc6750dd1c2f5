"""Write files and folders whole or not at all, and from one process at a time.

A lock is the system's (``flock``) on a small file beside the folder. It dies with its process,
however that ends, so there is never a stale lock to remove.
"""

from __future__ import annotations

import errno
import fcntl
import os
import platform
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from gva_mi.core.errors import InputError

_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS)  # on some file systems


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Yield a temporary path to write to, which replaces ``path`` once it is written whole.

    A symbolic link stays, and the file that it leads to is replaced. Every OSError, such as a full
    disk, gets the file's name.
    """
    path = link_target(path)
    unfinished = part_of(path)
    try:
        with with_filename(path):
            link_target(path.parent).mkdir(parents=True, exist_ok=True)
            yield unfinished
            unfinished.replace(path)
    finally:
        with suppress(OSError):
            unfinished.unlink(missing_ok=True)


def write_bytes(path: Path, *parts: bytes | memoryview) -> None:
    """Write a file whose content is in memory, whole or not at all."""
    with atomic_write(path) as unfinished, unfinished.open("wb") as file:
        file.writelines(parts)


def part_of(path: Path) -> Path:
    """Return where a file is written until it is whole; a later run overwrites leftovers."""
    return path.with_name(path.name + ".part")


@contextmanager
def with_filename(path: Path, keep: bool = False) -> Iterator[None]:
    """Add a file name to any OSError raised within, and replace or ``keep`` the one it has."""
    try:
        yield
    except OSError as error:
        if error.errno is None or (keep and error.filename is not None):
            raise
        raise OSError(error.errno, error.strerror, str(path)) from None


@contextmanager
def atomic_dir(out: Path, replaced: str | None = None) -> Iterator[Path]:
    """Yield a folder beside ``out`` that becomes ``out`` on success and is removed on failure.

    At any moment ``out`` is the old folder or the new one, whole. A killed process leaves its
    temporary folder behind; the next one that makes ``out`` removes it.

    An ``out`` that holds something is replaced only if it has the file ``replaced``, which marks
    folders that this program made.
    """
    out = link_target(out).absolute()
    unfinished, old = (out.with_name(f".{out.name}.gva-mi-{what}") for what in ("part", "old"))
    require_writable(out.parent)
    with folder_lock(out, "gva-mi"):
        if old.exists() and not out.exists():  # killed between its last two renames
            old.rename(out)
        for left in filter(Path.exists, (unfinished, old)):
            shutil.rmtree(left)
        if holds_something(out):
            if replaced is None:
                raise InputError(f"{out}: already exists; expected a new or an empty folder")
            require_ours(out, replaced)
        try:
            with with_filename(out, keep=True):
                unfinished.mkdir()
                yield unfinished
                if holds_something(out):
                    if replaced is None:
                        raise InputError(
                            f"{out}: was made by another process meanwhile; nothing is replaced"
                        )
                    out.rename(old)
                unfinished.rename(out)
        finally:
            for left in (unfinished, old):
                shutil.rmtree(left, ignore_errors=True)


@contextmanager
def folder_lock(folder: Path, doing: str) -> Iterator[None]:
    """Keep other processes from writing into a folder, which may be missing or replaced meanwhile.

    A second process gets an InputError that names the writing process and its start; ``doing`` is
    the command, such as ``gva-mi fit``. A file system without locks keeps nobody out.
    """
    folder = Path(os.path.realpath(folder))
    require_writable(folder.parent)
    path = folder.with_name(f".{folder.name}.lock")
    file = _acquire(path, folder)
    try:
        since = time.strftime("%Y-%m-%d %H:%M:%S")
        about = f"{doing} (process {os.getpid()} on {platform.node()}, since {since})"
        with suppress(OSError):  # on a full disk the lock still holds
            os.truncate(file, 0)
            os.write(file, about.encode())
        yield
    finally:
        with suppress(OSError):
            path.unlink()
        os.close(file)


def _acquire(path: Path, folder: Path) -> int:
    """Open and lock the file, and return its descriptor."""
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in _NO_LOCKS:
                return file
            holder = os.read(file, 4096).decode(errors="replace") or "another process"
            os.close(file)
            raise InputError(
                f"{folder}: {holder} writes there; wait until it ends, or choose another folder"
            ) from None
        # The previous holder may have removed the file between our opening and our locking it.
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(file), path.stat()):
                return file
        os.close(file)


def link_target(path: Path) -> Path:
    """Return where an output is written: a symbolic link stays, and what it leads to changes."""
    return Path(os.path.realpath(path)) if Path(path).is_symlink() else Path(path)


def require_writable(folder: Path) -> None:
    """Create a folder if it is missing, and raise an InputError if it takes no file."""
    try:
        link_target(folder).mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except (FileExistsError, NotADirectoryError):
        raise InputError(f"{folder}: cannot be written to: a file is in the way") from None
    except OSError as error:
        raise InputError(f"{folder}: cannot be written to ({error.strerror})") from None


def holds_something(folder: Path, marker: str | None = None) -> bool:
    """Return whether a folder is not empty; a half-written marker does not count."""
    if not folder.is_dir() and folder.exists():
        raise InputError(f"{folder}: is a file; expected a folder, or a new name for one")
    begun = part_of(folder / marker) if marker else None
    return folder.is_dir() and any(path != begun for path in folder.iterdir())


def require_ours(folder: Path, marker: str) -> None:
    """Raise an InputError if a folder lacks the marker file of this program's output folders."""
    if not (folder / marker).exists():
        raise InputError(
            f"{folder}: has no {marker}, so gva-mi did not make it and will not replace it"
        )
