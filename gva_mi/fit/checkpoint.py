"""A run's folder: what a fit writes, to be looked at, evaluated, or resumed after a kill.

::

    out/
      options.json         options and versions that made it
      checkpoint.pt        the last saved state, until the run is finished
      history.npz          per step: loss and its terms, Gaussians, milliseconds
      reinit/000900.npz    of each re-initialisation: the Gaussians before and after, the mesh
      poses.npz            of all frames, where poses were trained; see gva_mi.fit.poses
      avatar.npz           the fitted avatar; it is there when the run is finished

A file is written under another name and then renamed: after a kill it is the old one or the new
one, whole.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import torch

from gva_mi.avatar.canonical import CanonicalGaussians
from gva_mi.avatar.reinit import SurfaceMesh
from gva_mi.errors import InputError
from gva_mi.files import read_arrays, replacing, write_arrays, write_json
from gva_mi.splat import Gaussians

AVATAR, CHECKPOINT, HISTORY = "avatar.npz", "checkpoint.pt", "history.npz"
OPTIONS, POSES, REINIT = "options.json", "poses.npz", "reinit"
GAUSSIANS = ("means", "quats", "scales", "opacities", "sh")
PACKAGES = ("gva_mi", "torch", "drjit", "numpy")  # whose versions may change the figures


def claim(out: Path, options: dict[str, Any], resume: bool) -> None:
    """Make a folder the home of a run, and write down what the run is.

    Args:
        out: the folder; made where it is missing.
        options: of the run, plain values.
        resume: whether a run of the same options may be there already.

    Raises:
        InputError: a run is there and is not to be resumed, or was made with other options.
    """
    held = out / OPTIONS
    if not held.exists():
        if (out / AVATAR).exists() or (out / CHECKPOINT).exists():
            raise InputError(f"{out}: holds a run, but not its {OPTIONS}; choose another folder")
        out.mkdir(parents=True, exist_ok=True)
        found = {"options": options, "versions": versions()}
        write_json(held, found)
        return
    if not resume:
        raise InputError(f"{out}: already holds a run; resume it, overwrite it, or choose another")
    try:
        before = json.loads(held.read_text())["options"]
    except (ValueError, KeyError, TypeError):
        raise InputError(f"{held}: not readable; expected the options of a run") from None
    now = json.loads(json.dumps(options))
    for name in sorted(before.keys() | now.keys()):
        if before.get(name) != now.get(name):
            raise InputError(
                f"{held}: the run was made with {name} = {before.get(name)}, not {now.get(name)}; "
                "resume it with its own options, or choose another folder"
            )


def save_state(out: Path, state: dict[str, Any]) -> None:
    """Write the checkpoint: tensors, numbers, strings, and lists and dictionaries of them."""
    with replacing(out / CHECKPOINT) as unfinished:
        torch.save(state, unfinished)


def load_state(out: Path) -> dict[str, Any] | None:
    """Read the checkpoint; None where there is none yet.

    Raises:
        InputError: one that cannot be read.
    """
    path = out / CHECKPOINT
    if not path.exists():
        return None
    try:
        return torch.load(path, weights_only=True)
    except Exception as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"{path}: not a readable checkpoint ({reason})") from None


def save_snapshot(
    out: Path,
    step: int,
    before: CanonicalGaussians,
    after: CanonicalGaussians,
    surface: SurfaceMesh,
) -> None:
    """Write the Gaussians on both sides of a re-initialisation, and the surface between them."""
    arrays = {"vertices": surface.vertices, "faces": surface.faces}
    for side, gaussians in (("before", before), ("after", after)):
        for name in GAUSSIANS:
            arrays[f"{side}_{name}"] = getattr(gaussians, name).detach().numpy()
    write_arrays(out / REINIT / f"{step:06d}.npz", **arrays)


def load_snapshots(out: Path) -> Iterator[tuple[int, Gaussians, Gaussians]]:
    """Step, Gaussians before, Gaussians after, of each re-initialisation, in the rest pose."""
    for path in sorted((out / REINIT).glob("*.npz")):
        arrays = read_arrays(path, "the Gaussians around a re-initialisation")
        before, after = (
            Gaussians(**{n: torch.from_numpy(arrays[f"{side}_{n}"]) for n in GAUSSIANS})
            for side in ("before", "after")
        )
        yield int(path.stem), before, after


def load_history(out: Path) -> dict[str, np.ndarray]:
    """The history of a run by the names of its columns, each (steps,)."""
    return read_arrays(out / HISTORY, "the history of a finished fit")


def versions() -> dict[str, str]:
    """Of Python and of the packages whose versions may change the figures."""
    found = {"python": platform.python_version()}
    return found | {name: metadata.version(name) for name in PACKAGES}
