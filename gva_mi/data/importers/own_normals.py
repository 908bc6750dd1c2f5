"""Normals that a user brings: maps of another program, or by a network in an ONNX file.

A map shows a whole frame. Maps belong to frames by the last number in their names: that of the
frame's own file where frames are files; of a film, the first is 0, or 1 where the maps count from 1
to the last.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import astuple
from pathlib import Path

import numpy as np

from gva_mi.core.atomic import atomic_write
from gva_mi.core.console import Progress, listed
from gva_mi.core.errors import InputError, expecting
from gva_mi.data.crop import bounds
from gva_mi.data.folder import FRAMES, MASKS, NORMALS, SubjectWriter, frame_name
from gva_mi.data.importers.footage import PICTURES, Pictures, files_of, number_in
from gva_mi.data.masks import read_mask
from gva_mi.data.networks.normals import NormalNetwork
from gva_mi.data.normals import Convention, NormalMaps, read_map
from gva_mi.data.pictures import in_8_bits, read_image, require_sides, write_image
from gva_mi.splat import Camera


def maps_of(folder: Path, frames: Pictures, count: int, loose: bool) -> dict[int, Path]:
    """Return the map file of each frame that has one.

    The subject's frames are the first ``count`` of ``frames``; with ``loose``, maps without a frame
    are ignored.
    """
    kinds = (*PICTURES, ".npy")
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in kinds)
    if not paths:
        raise InputError(f"{folder}: holds no normals ({', '.join(kinds)})")
    numbers = {path: _number(path) for path in paths}
    both = [number for number, times in Counter(numbers.values()).items() if times > 1]
    if both:
        names = " and ".join(path.name for path, k in numbers.items() if k == both[0])
        raise InputError(f"{folder}: {names} are both of frame {both[0]}; expected one map each")
    files = files_of(frames)
    known = [_number(path) for path in files[:count]] if files else list(range(count))
    if not files and sorted(numbers.values()) == list(range(1, count + 1)):
        known = list(range(1, count + 1))
    places = {number: k for k, number in enumerate(known)}
    if len(places) < len(known):
        raise InputError(f"{folder}: frames of the same number; their normals cannot be told apart")
    found = {places[number]: path for path, number in numbers.items() if number in places}
    astray = [path for path, number in numbers.items() if number not in places]
    if not found or (astray and not loose):
        raise InputError(
            f"{astray[0]}: is of no frame; frames are numbered {listed(np.sort(known))}, "
            "and normals go by the last number in their names"
        )
    return found


def write_maps(
    out: Path,
    maps: dict[int, Path],
    convention: Convention,
    cameras: Sequence[Camera],
    straight: Callable[[np.ndarray], np.ndarray] | None,
) -> list[str]:
    """Write ``normals/`` and ``normals.json`` of a subject's folder with masks; return notes.

    ``straight`` takes the lens's distortion out of an 8-bit picture; None: a pinhole.
    """
    for k, path in sorted(maps.items()):
        stored = _read(path, cameras[k])
        if straight is not None:
            stored = straight(in_8_bits((stored + 1) / 2) if stored.dtype.kind == "f" else stored)
        if stored.dtype == np.uint8:
            write_image(out / NORMALS / frame_name(k), stored)
        else:
            with atomic_write(out / NORMALS / frame_name(k, ".npy")) as unfinished:
                with unfinished.open("wb") as file:
                    np.save(file, stored)
    SubjectWriter(out).normals_record(convention)
    read, pixels, z = NormalMaps(out / NORMALS, convention, None), 0, 0.0
    for k in sorted(maps):
        mask = read_mask(out / MASKS, k)
        if mask is not None:
            inside = read.read(k, cameras[k])[mask > 0.5]
            pixels, z = pixels + int(inside.any(axis=1).sum()), z + float(inside[:, 2].sum())
    where = next(iter(maps.values())).parent
    if not pixels:
        raise InputError(
            f"{where}: no pixel inside the masks is a unit vector; expected (n + 1) / 2 in "
            "pictures, n in .npy"
        )
    if z > 0:
        raise InputError(
            f"{where}: most normals look away from the camera if they are {convention}; expected "
            "another --normals-convention"
        )
    return [f"normals of {len(maps)} frames from {where.name}, {convention}"]


def _number(path: Path) -> int:
    with expecting(path, "the frame's number in the name, such as normal_000012.png"):
        return number_in(path)


def _read(path: Path, camera: Camera) -> np.ndarray:
    """Read a map as it is stored, (H, W, 3) 8-bit or float32."""
    stored = read_map(path)
    if stored.dtype.kind == "f":
        stored = np.nan_to_num(stored.astype(np.float32))
        if (stored > 0).any() and not (stored < 0).any():
            raise InputError(f"{path}: holds no number below 0, such as (n + 1) / 2; expected n")
    require_sides(f"{path}:", stored, camera.width, camera.height)
    return stored


def write_normals(
    folder: Path,
    network: NormalNetwork,
    count: int,
    progress: Progress | None = None,
) -> list[str]:
    """Write ``normals/`` and ``normals.json`` of a subject that has its masks; return notes.

    A map shows a part of the frame, which ``normals.json`` says, at the network's own resolution.

    Args:
        folder: of the subject.
        network: that sees the pictures.
        count: of the frames.
        progress: called after every frame.
    """
    writer, boxes, maps = SubjectWriter(folder), [[0, 0, 1, 1]] * count, 0
    for k in range(count):
        mask = read_mask(folder / MASKS, k)
        box = None if mask is None else bounds(mask > 0.5)
        if box is not None:
            image = read_image(folder / FRAMES / frame_name(k), 3)
            crop, normals = network.see(image, mask, box)
            boxes[k] = list(astuple(crop))
            writer.normals(k, normals)
            maps += 1
        if progress:
            progress(k + 1, count)
    writer.normals_record(network.spec.convention, boxes)
    return [f"normals of {maps} frames by {network.path.name}, {network.spec.convention}"]
