"""Write a folder of files, one per frame, so that an interrupted command can resume.

Each file is whole or missing, and a marker holds a hash of everything the files depend on. The
same command, run again, writes only the missing files, and they get the bits of an uninterrupted
run. ``render`` and ``export`` work this way.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from gva_mi.avatar.avatar import Avatar
from gva_mi.body.pose import Pose
from gva_mi.core.atomic import require_writable
from gva_mi.core.console import say
from gva_mi.core.errors import InputError
from gva_mi.core.files import read_json, start_folder
from gva_mi.core.lock import folder_lock
from gva_mi.core.provenance import hash_arrays, program_digest, versions
from gva_mi.fit.renders import CameraShot

HASH = "made_of"  # its name in the marker


@contextmanager
def series(
    out: Path, marker: str, names: Sequence[str], overwrite: bool, about: dict[str, Any]
) -> Iterator[list[str]]:
    """Lock a folder, then start it anew or continue it; yield those of ``names`` that are missing.

    ``about`` is the content of the ``marker`` file; under :data:`HASH` what all files depend on. An
    InputError says that the folder holds something else, or all files already.
    """
    with folder_lock(out, f"gva-mi {Path(marker).stem}"):
        missing = [name for name in names if not (out / name).exists()]
        if overwrite or not missing or _hash_in(out / marker) != about[HASH]:
            start_folder(out, marker, overwrite, about)
            missing = list(names)
        else:
            require_writable(out)
            if len(missing) < len(names):
                say(f"{out}: goes on, {len(names) - len(missing)} of {len(names)} files are there")
        yield missing


def hash_of(
    avatar: Avatar, motion: Pose, shots: Iterable[CameraShot], how: Iterable[object]
) -> str:
    """Return a hash of everything that the files of a folder depend on, this program included.

    Without pictures there are no ``shots``; ``how`` holds other numbers, words and arrays.
    """
    lens = lambda camera: f"{camera.model}, {camera.width}x{camera.height}"
    cameras = (x for s in shots for x in (s.frame, s.camera.K, s.camera.T_camera_world,
                                          lens(s.camera)))  # fmt: skip
    arrays = (*avatar.record().values(), *motion.to_smplx().values(), *cameras, *how)
    return hash_arrays((program_digest(), json.dumps(versions()), *arrays))


def _hash_in(path: Path) -> str | None:
    """Return the hash in a marker; None if it is missing or cannot be read."""
    try:
        found = read_json(path, "what this folder holds")
    except InputError:
        return None
    return found.get(HASH) if isinstance(found, dict) else None
