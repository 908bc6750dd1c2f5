"""Reader of SuperSplat's compressed .ply: 16 bytes a Gaussian, and a byte a coefficient.

Layout and rounding are those of playcanvas/splat-transform (``compressed-chunk.ts``,
``write-compressed-ply.ts``). Gaussians are stored in chunks of 256, the last may have fewer:

    element chunk   float  min_x y z, max_x y z, min_scale_x y z, max_scale_x y z,
                           in newer files min_r g b, max_r g b
    element vertex  uint   packed_position, packed_rotation, packed_scale, packed_color
    element sh      uchar  f_rest_0 … 8, 23 or 44, where colours depend on the direction

* a position and a scale have 11, 10, 11 bits from the highest bit on, between the chunk's minimum
  (0) and maximum (all ones); scales are logarithms;
* a colour has 8 bits each of red, green, blue, opacity; it is f_dc C0 + 1/2, between the chunk's
  bounds if there are some; the opacity is not a logit;
* a rotation has 2 bits for the index of the largest of w, x, y, z, and 10 bits for each other one,
  from -sqrt(1/2) to sqrt(1/2); the largest is positive and follows from length 1;
* f_rest goes channel by channel, from -4 (0) to 4 (255); a byte in between means its middle.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from gva_mi.core.errors import InputError
from gva_mi.splat.gaussians import Gaussians
from gva_mi.splat.kernels.sh import C0

CHUNK = 256  # Gaussians
PACKED = tuple(f"packed_{name}" for name in ("position", "rotation", "scale", "color"))
REST = (9, 24, 45)  # properties of "sh"


def is_compressed(elements: dict[str, np.ndarray]) -> bool:
    """Whether the tables of a .ply are in the compressed format."""
    return "vertex" in elements and PACKED[0] in elements["vertex"].dtype.names


def decompressed(path: Path, elements: dict[str, np.ndarray]) -> Gaussians:
    """Decode the Gaussians of a compressed .ply.

    Args:
        path: of the file, for errors.
        elements: its tables.

    Raises:
        InputError: a table or property is missing or does not fit, or a number is not finite.
    """
    vertex, chunk = elements["vertex"], _chunks_of(path, elements)
    position, rotation, scale, color = (vertex[name] for name in PACKED)
    means = _between(chunk, "min_", "max_", "xyz", _fields(position, (11, 10, 11)))
    scales = _between(chunk, "min_scale_", "max_scale_", "xyz", _fields(scale, (11, 10, 11)))
    rgba = _fields(color, (8, 8, 8, 8))
    rgb = rgba[:, :3]
    if "min_r" in chunk.dtype.names:
        rgb = _between(chunk, "min_", "max_", "rgb", rgb)
    sh = np.concatenate([((rgb - 0.5) / C0)[:, None], _rest_of(path, elements)], axis=1)
    with np.errstate(over="ignore"):
        scales = np.exp(scales).astype(np.float32)
    if not all(np.isfinite(numbers).all() for numbers in (means, scales, sh)):
        raise InputError(f"{path}: a chunk's bounds are not finite, or too large")
    tensor = lambda numbers: torch.from_numpy(np.ascontiguousarray(numbers, dtype=np.float32))
    return Gaussians(
        means=tensor(means),
        quats=tensor(_quaternions(rotation)),
        scales=tensor(scales),
        opacities=tensor(rgba[:, 3]),
        sh=tensor(sh),
    )


def _chunks_of(path: Path, elements: dict[str, np.ndarray]) -> np.ndarray:
    """Check the tables, and return the chunk of each Gaussian, (N,)."""
    vertex, chunk = elements["vertex"], elements.get("chunk")
    if chunk is None:
        raise InputError(f"{path}: element 'chunk' is missing; expected a compressed .ply")
    bounds = [f"{end}_{of}" for end in ("min", "max") for of in (*"xyz", *_named("scale"))]
    if "min_r" in chunk.dtype.names:
        bounds += [f"{end}_{of}" for end in ("min", "max") for of in "rgb"]
    _require(path, "vertex", vertex, PACKED, "<u4", "uint")
    _require(path, "chunk", chunk, bounds, "<f4", "float")
    count = -(-len(vertex) // CHUNK)
    if len(chunk) != count:
        found = f"{len(chunk)} chunks of {len(vertex)} Gaussians"
        raise InputError(f"{path}: {found}; expected {count}, one for every {CHUNK}")
    return chunk[np.arange(len(vertex)) // CHUNK]


def _named(name: str) -> list[str]:
    return [f"{name}_{axis}" for axis in "xyz"]


def _require(
    path: Path,
    element: str,
    table: np.ndarray,
    names: tuple[str, ...] | list[str],
    kind: str,
    of: str,
) -> None:
    """Check that a table has all properties, in the right type."""
    for name in names:
        if name not in (table.dtype.names or ()) or table.dtype[name] != np.dtype(kind):
            raise InputError(
                f"{path}: property '{name}' of '{element}' is missing; expected it as {of}, "
                "as SuperSplat writes a compressed .ply"
            )


def _rest_of(path: Path, elements: dict[str, np.ndarray]) -> np.ndarray:
    """Decode the coefficients above the constant one, (N, K - 1, 3)."""
    vertex, table = elements["vertex"], elements.get("sh")
    if table is None:
        return np.zeros((len(vertex), 0, 3))
    count = len(table.dtype.names or ())
    if len(table) != len(vertex) or count not in REST:
        found = f"{len(table)} rows of {count} in 'sh'"
        raise InputError(f"{path}: {found}; expected {len(vertex)} of 9, 24 or 45")
    names = [f"f_rest_{i}" for i in range(count)]
    _require(path, "sh", table, names, "u1", "uchar")
    byte = np.column_stack([table[name] for name in names]).astype(np.float64)
    share = np.where(byte == 0, 0, np.where(byte == 255, 1, (byte + 0.5) / 256))
    return (8 * share - 4).reshape(len(vertex), 3, count // 3).transpose(0, 2, 1)


def _fields(packed: np.ndarray, bits: tuple[int, ...]) -> np.ndarray:
    """Unpack numbers in [0, 1] of so many bits each, the last one lowest, (N, len(bits))."""
    columns, shift = [], 0
    for width in reversed(bits):
        most = (1 << width) - 1
        columns.insert(0, ((packed >> np.uint32(shift)) & np.uint32(most)) / most)
        shift += width
    return np.column_stack(columns)


def _between(chunk: np.ndarray, low: str, high: str, axes: str, share: np.ndarray) -> np.ndarray:
    """Interpolate between the bounds of each Gaussian's chunk by ``share`` (N, 3)."""
    start, end = (
        np.column_stack([chunk[name + axis] for axis in axes]).astype(np.float64)
        for name in (low, high)
    )
    return start * (1 - share) + end * share


def _quaternions(packed: np.ndarray) -> np.ndarray:
    """Unpack unit quaternions wxyz, (N, 4)."""
    largest = (packed >> np.uint32(30)).astype(int)
    others = (2 * _fields(packed, (10, 10, 10)) - 1) * np.sqrt(0.5)
    missing = np.sqrt(np.maximum(0, 1 - (others**2).sum(axis=1)))
    quats = np.empty((len(packed), 4))
    for k in range(4):
        rows = largest == k
        quats[rows] = np.insert(others[rows], k, missing[rows], axis=1)
    return quats
