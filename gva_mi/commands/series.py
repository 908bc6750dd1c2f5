"""A folder of files that ``render`` and ``export`` write one by one, a frame each.

Each file is whole or not there, and a marker says by a hash what all of them depend on. So a series
that was cut short is gone on with by whoever asks for the very same; the files that are there have
the bits that they would get again.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.pose import Pose
from gva_mi.console import say
from gva_mi.data.identity import of_arrays
from gva_mi.errors import InputError
from gva_mi.files import (
    program_digest,
    read_json,
    require_writable,
    start_folder,
    versions,
)
from gva_mi.fit.camera_paths import Shot
from gva_mi.lock import alone_in

HASH = "made_of"  # its name in the marker


@contextmanager
def series(
    out: Path, marker: str, names: Sequence[str], overwrite: bool, about: dict[str, Any]
) -> Iterator[list[str]]:
    """Keep others from writing into a folder, make room in it, or go on with what is there.

    Args:
        out: the folder.
        marker: name of a file that every such folder holds.
        names: of all files that are to be written.
        overwrite: whether all is to be made again.
        about: what the marker says; under :data:`HASH` what all files depend on.

    Yields:
        The names that are missing, in their order.

    Raises:
        InputError: the folder holds something else, or all of it; or another process writes there.
    """
    verb = Path(marker).stem
    with alone_in(out, f"gva-mi {verb}"):
        missing = [name for name in names if not (out / name).exists()]
        if overwrite or not missing or _hash_in(out / marker) != about[HASH]:
            start_folder(out, marker, overwrite, about)
            missing = list(names)
        else:
            require_writable(out)
            if len(missing) < len(names):
                say(f"{out}: goes on, {len(names) - len(missing)} of {len(names)} files are there")
        yield missing


def hash_of(avatar: Avatar, motion: Pose, shots: Iterable[Shot], how: Iterable[object]) -> str:
    """A hash of what renders, and other files, depend on: this program is a part of that.

    Args:
        avatar: that is driven.
        motion: by which.
        shots: the pictures to be taken; none for files without cameras.
        how: numbers, words and arrays: all else.
    """
    cameras = (x for s in shots for x in (s.frame, s.camera.K, s.camera.T_camera_world, _lens(s)))
    arrays = (*avatar.record().values(), *motion.to_smplx().values(), *cameras, *how)
    return of_arrays((program_digest(), json.dumps(versions()), *arrays))


def _lens(shot: Shot) -> str:
    return f"{shot.camera.model}, {shot.camera.width}x{shot.camera.height}"


def _hash_in(path: Path) -> str | None:
    """What a marker's files depend on; None where it does not say, or is not there."""
    try:
        found = read_json(path, "what this folder holds")
    except InputError:
        return None
    return found.get(HASH) if isinstance(found, dict) else None
