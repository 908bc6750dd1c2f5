"""Writer of SuperSplat's compressed .ply.

The layout is described in :mod:`.compressed_ply`. Gaussians are written along a Morton curve, so
that those of a chunk are close together and its bounds are narrow: the rounding error of a number
is at most half a step of its chunk's range.

===========  =======================================================
Number       Rounding error, at most
===========  =======================================================
mean         1/4094 (x, z) or 1/2046 (y) of its chunk's extent
log scale    likewise of its chunk's range
quaternion   1/1446 in each of the three components that are stored
opacity      0.5 / 255
colour       1/510 of its chunk's range
harmonics    1/32 within ±4, clipped beyond
===========  =======================================================
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gva_mi.core.atomic import atomic_write
from gva_mi.core.errors import InputError
from gva_mi.splat.formats.compressed_ply import CHUNK, PACKED
from gva_mi.splat.formats.stored import Stored
from gva_mi.splat.gaussians import Gaussians
from gva_mi.splat.kernels.sh import C0

_MAX_LOG_SCALE = 20.0  # of either sign; SuperSplat's own bounds
_MORTON_BITS = 10  # of each axis


def save_compressed_ply(path: Path, gaussians: Gaussians) -> None:
    """Write Gaussians, rounded to the format's bits, in another order.

    Args:
        path: of the .ply; an older one is replaced once the new one is whole.
        gaussians: torch tensors; plain colours become the constant band of spherical harmonics.

    Raises:
        InputError: harmonics of degree 4, which the format lacks, or numbers that are not finite.
    """
    stored = Stored.of(path, gaussians)
    if stored.degree > 3:
        raise InputError(f"{path}: a compressed .ply holds harmonics up to degree 3")
    scales = np.clip(stored.log_scales, -_MAX_LOG_SCALE, _MAX_LOG_SCALE)
    order = _morton(stored.means)
    columns = (stored.means, scales, stored.sh[:, 0] * C0 + 0.5)
    bounds, shares = zip(*(_in_chunks(x[order]) for x in columns), strict=True)
    rgba = np.column_stack([shares[2], np.clip(stored.opacities[order], 0, 1)])
    vertex = np.column_stack(
        [
            _packed(shares[0], (11, 10, 11)),
            _rotations(stored.unit_quats[order]),
            _packed(shares[1], (11, 10, 11)),
            _packed(rgba, (8, 8, 8, 8)),
        ]
    )
    rest = stored.rest[order]
    tables = [
        ("chunk", "float", _bounds_named(), np.concatenate(bounds, axis=1).astype("<f4")),
        ("vertex", "uint", PACKED, vertex.astype("<u4")),
    ]
    if rest.shape[1]:
        names = [f"f_rest_{i}" for i in range(rest.shape[1])]
        byte = np.clip(np.floor((rest / 8 + 0.5) * 256), 0, 255).astype("u1")
        tables.append(("sh", "uchar", names, byte))
    header = ["ply", "format binary_little_endian 1.0"]
    for element, kind, names, table in tables:
        header.append(f"element {element} {len(table)}")
        header += [f"property {kind} {name}" for name in names]
    content = "\n".join([*header, "end_header\n"]).encode("ascii")
    with atomic_write(path) as unfinished:
        unfinished.write_bytes(content + b"".join(table.tobytes() for *_, table in tables))


def _bounds_named() -> list[str]:
    """Names of a chunk's properties, in order."""
    groups = [[f"{kind}{axis}" for axis in axes]
              for kind, axes in (("", "xyz"), ("scale_", "xyz"), ("", "rgb"))]  # fmt: skip
    return [f"{end}_{name}" for names in groups for end in ("min", "max") for name in names]


def _morton(means: np.ndarray) -> np.ndarray:
    """Sort points (N, 3) along a Morton curve through their bounding box."""
    low, high = means.min(0, initial=np.inf), means.max(0, initial=-np.inf)
    cells = (1 << _MORTON_BITS) - 1
    with np.errstate(invalid="ignore"):
        spot = ((means - low) / np.maximum(high - low, 1e-12) * cells).astype(np.int64)
    code = np.zeros(len(means), np.int64)
    for bit in range(_MORTON_BITS):
        for axis in range(3):
            code |= (spot[:, axis] >> bit & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")


def _in_chunks(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return each chunk's bounds (M, 6) float32, and values (N, 3) relative to them, in [0, 1]."""
    starts = np.arange(0, len(values), CHUNK)
    if not len(starts):
        return np.zeros((0, 6), np.float32), np.zeros((0, 3))
    low, high = (of.reduceat(values, starts).astype(np.float32) for of in (np.minimum, np.maximum))
    of_each = np.arange(len(values)) // CHUNK
    start, end = (x.astype(np.float64)[of_each] for x in (low, high))
    extent = end - start
    shares = np.divide(values - start, extent, out=np.zeros_like(values), where=extent > 0)
    return np.concatenate([low, high], axis=1), np.clip(shares, 0, 1)


def _packed(shares: np.ndarray, bits: tuple[int, ...]) -> np.ndarray:
    """Pack numbers (N, len(bits)) in [0, 1] into so many bits each, the last one lowest, (N,)."""
    packed = np.zeros(len(shares), np.int64)
    for column, width in zip(shares.T, bits, strict=True):
        packed = packed << width | np.floor(column * ((1 << width) - 1) + 0.5).astype(np.int64)
    return packed


def _rotations(quats: np.ndarray) -> np.ndarray:
    """Pack unit quaternions wxyz (N, 4), (N,)."""
    largest = np.abs(quats).argmax(axis=1)
    rows = np.arange(len(quats))
    quats = quats * np.where(quats[rows, largest] < 0, -1, 1)[:, None]
    others = quats[np.arange(4) != largest[:, None]].reshape(-1, 3)
    return largest << 30 | _packed(np.clip(others * np.sqrt(0.5) + 0.5, 0, 1), (10, 10, 10))
