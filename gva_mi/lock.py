"""One process at a time writes into a folder; a second one is told who does.

The lock is the system's (``flock``), on a small file beside the folder: it dies with the process
that holds it, however that ends, so there is none that somebody would have to remove.
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

from gva_mi.errors import InputError

_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS)  # on some file systems


@contextmanager
def alone_in(folder: Path, doing: str) -> Iterator[bool]:
    """Keep other processes from writing into a folder.

    Args:
        folder: it may be missing, and may be replaced meanwhile.
        doing: what is done there, for whoever is kept away, such as ``gva-mi fit``.

    Yields:
        Whether the file system knows locks; where it does not, nobody is kept away.

    Raises:
        InputError: another process writes there; the sentence says which, where, and since when.
    """
    folder = Path(folder).resolve()
    folder.parent.mkdir(parents=True, exist_ok=True)
    path = folder.with_name(f".{folder.name}.lock")
    file, locked = _taken(path, folder)
    try:
        about = {"doing": doing, "pid": os.getpid(), "host": platform.node()}
        about["since"] = time.strftime("%Y-%m-%d %H:%M:%S")
        with suppress(OSError):  # a full disk: the lock holds, and the work's own files will say so
            os.truncate(file, 0)
            os.write(file, json.dumps(about).encode())
        yield locked
    finally:
        with suppress(OSError):  # the file itself means nothing: the lock goes as it is closed
            path.unlink()
        os.close(file)


def _taken(path: Path, folder: Path) -> tuple[int, bool]:
    """The open file of the lock, which this process holds now; whether there are locks at all."""
    while True:
        file = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            holder = os.read(file, 4096)
            os.close(file)
            if error.errno not in _NO_LOCKS:
                raise InputError(f"{folder}: {_in_words(holder)} writes there; wait until it ends, "
                                 "or choose another folder") from None  # fmt: skip
            return os.open(path, os.O_RDWR), False
        # Who held it before may have removed the file between our opening and our locking it.
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(file), path.stat()):
                return file, True
        os.close(file)


def _in_words(holder: bytes) -> str:
    """Who holds a lock, as its file says."""
    try:
        about = json.loads(holder)
        process = f"process {about['pid']} on {about['host']}, since {about['since']}"
        return f"{about['doing']} ({process})"
    except (ValueError, KeyError, TypeError):
        return "another process"
