"""Let only one process at a time write into a folder; a second one learns which process does.

The lock is the system's (``flock``) on a small file beside the folder. It dies with its process,
however that ends, so there is never a stale lock to remove.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
import platform
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from gva_mi.core.errors import InputError

_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS)  # on some file systems


@contextmanager
def folder_lock(folder: Path, doing: str) -> Iterator[bool]:
    """Keep other processes from writing into a folder, which may be missing or replaced meanwhile.

    A second process gets an InputError that names the writing process and its start; ``doing`` is
    the command, such as ``gva-mi fit``. Yields whether the file system has locks; without them no
    process is kept out.
    """
    folder = Path(os.path.realpath(folder))
    folder.parent.mkdir(parents=True, exist_ok=True)
    path = folder.with_name(f".{folder.name}.lock")
    file, locked = _acquire(path, folder)
    try:
        about = {"doing": doing, "pid": os.getpid(), "host": platform.node()}
        about["since"] = time.strftime("%Y-%m-%d %H:%M:%S")
        with suppress(OSError):  # on a full disk the lock still holds
            os.truncate(file, 0)
            os.write(file, json.dumps(about).encode())
        yield locked
    finally:
        with suppress(OSError):
            path.unlink()
        os.close(file)


def _acquire(path: Path, folder: Path) -> tuple[int, bool]:
    """Open and lock the file; return its descriptor, and whether the file system has locks."""
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in _NO_LOCKS:
                return file, False
            holder = os.read(file, 4096)
            os.close(file)
            raise InputError(
                f"{folder}: {_describe(holder)} writes there; wait until it ends, or choose "
                "another folder"
            ) from None
        # The previous holder may have removed the file between our opening and our locking it.
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(file), path.stat()):
                return file, True
        os.close(file)


def _describe(holder: bytes) -> str:
    """Return the process that holds a lock, as the lock's file describes it."""
    try:
        about = json.loads(holder)
        process = f"process {about['pid']} on {about['host']}, since {about['since']}"
        return f"{about['doing']} ({process})"
    except (ValueError, KeyError, TypeError):
        return "another process"
