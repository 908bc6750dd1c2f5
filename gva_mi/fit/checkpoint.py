"""The checkpoint of a run: its last saved state, until the run is finished."""

from __future__ import annotations

import io
from hashlib import sha256
from pathlib import Path
from typing import Any

import torch

from gva_mi.core.atomic import part_of, write_bytes
from gva_mi.core.errors import InputError
from gva_mi.core.files import read_bytes
from gva_mi.fit.run_folder import CHECKPOINT, OPTIONS


def save_state(out: Path, state: dict[str, Any]) -> None:
    """Write the checkpoint: tensors, numbers, strings, and lists and dictionaries of them.

    A digest follows them, of these bytes and of the run's options, so that a state that was changed
    by hand or belongs to another run is refused when it is opened, and not somewhere in training.
    """
    whole = io.BytesIO()  # torch's own writer hides a full disk
    torch.save(state, whole)
    write_bytes(out / CHECKPOINT, whole.getbuffer(), _digest(out, whole.getbuffer()))


def load_state(out: Path) -> dict[str, Any] | None:
    """Read the checkpoint; None without one; an InputError unless it is as it was saved."""
    path = out / CHECKPOINT
    if not path.exists():
        return None
    whole = read_bytes(path, "the checkpoint of a run")
    content = memoryview(whole)[: -sha256().digest_size]
    if whole[len(content) :] != _digest(out, content):
        raise InputError(
            f"{path}: not as this run saved it: cut short, changed, of another run or of an older "
            "version; --overwrite starts the fit again"
        )
    return torch.load(io.BytesIO(content), weights_only=True)


def _digest(out: Path, content: memoryview) -> bytes:
    options = out / OPTIONS
    digest = sha256(options.read_bytes() if options.is_file() else b"")
    digest.update(content)
    return digest.digest()


def drop_state(out: Path) -> None:
    """Remove the checkpoint of a finished run, also one that a kill left half-written."""
    for path in (out / CHECKPOINT, part_of(out / CHECKPOINT)):
        path.unlink(missing_ok=True)
