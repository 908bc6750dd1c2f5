"""The .ply of 3D Gaussian Splatting: reader and writer.

One binary little-endian vertex per Gaussian, all float32, in the order of the original code:

    x y z · nx ny nz · f_dc_0..2 · f_rest_0.. · opacity · scale_0..2 · rot_0..3

* normals are zero, ``opacity`` is a logit, ``scale`` a logarithm, ``rot`` a quaternion wxyz;
* f_rest goes channel by channel: all red coefficients, then green, then blue;
* y is down and z forward (:mod:`gva_mi.splat.axes`).

The reader also takes text, big-endian numbers and any type, ``red green blue`` instead of f_dc, and
the flat Gaussians of 2D Gaussian Splatting, which have no ``scale_2``.

---
SuperSplat's compressed .ply: 16 bytes a Gaussian, and a byte a coefficient.

Layout and rounding are those of playcanvas/splat-transform (``compressed-chunk.ts``,
``write-compressed-ply.ts``). Gaussians are stored in chunks of 256, the last may have fewer:

    element chunk   float  min_x y z, max_x y z, min_scale_x y z, max_scale_x y z,
                           in newer files min_r g b, max_r g b
    element vertex  uint   packed_position, packed_rotation, packed_scale, packed_color
    element sh      uchar  f_rest_0 … 8, 23 or 44, where colours depend on the direction

===========  ================================================  =====================================
Number       Stored                                            Rounding error, at most
===========  ================================================  =====================================
mean         11, 10, 11 bits from its chunk's minimum (0) to   1/4094 (x, z) or 1/2046 (y) of the
             its maximum (all ones)                            chunk's extent
log scale    likewise                                          likewise
colour       f_dc C0 + 1/2 in 8 bits a channel, likewise if    1/510 of the chunk's range
             the chunk has bounds
opacity      8 bits, not a logit                               0.5 / 255
quaternion   2 bits: the largest of w, x, y, z, made           1/1446 of the others
             positive; the others in 10 bits, within ±√½
harmonics    8 bits within ±4, a byte between means its        1/32; clipped beyond
             middle; channel by channel
===========  ================================================  =====================================

The writer puts Gaussians along a Morton curve, so that those of a chunk are close together and its
bounds are narrow.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from gva_mi.core.atomic import write_bytes
from gva_mi.core.errors import InputError
from gva_mi.splat.formats.ply_elements import TYPES, ply_parts, read_elements
from gva_mi.splat.formats.stored import (
    Stored,
    from_rest,
    gaussians_of,
    pack,
    unpack,
    with_largest,
    without_largest,
)
from gva_mi.splat.gaussians import Gaussians, degree_of
from gva_mi.splat.kernels.sh import C0

_DC, _RGB = ("f_dc_0", "f_dc_1", "f_dc_2"), ("red", "green", "blue")
_GEOMETRY = ["opacity", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
_MARGIN = 1e-7  # distance of opacities to 0 and 1, whose logits are infinite


def save_ply(path: Path, gaussians: Gaussians) -> None:
    """Write Gaussians of torch tensors in the format of 3DGS; plain colours become the constant
    band.

    Raises:
        InputError: numbers that are not finite.
    """
    stored = Stored.of(path, gaussians)
    eta = np.clip(stored.opacities, _MARGIN, 1 - _MARGIN)
    table = np.column_stack(
        [
            stored.means,
            np.zeros_like(stored.means),
            stored.sh[:, 0],
            stored.rest,
            np.log(eta / (1 - eta)),
            stored.log_scales,
            stored.quats,
        ]
    )
    names = _properties(stored.sh.shape[1])
    write_bytes(path, *ply_parts([("vertex", "float", names, table)]))


def load_ply(path: Path) -> Gaussians:
    """Read a .ply of 3DGS or 2DGS, or a compressed one of SuperSplat.

    Properties may come in any order; unknown properties and elements are ignored.

    Raises:
        InputError: not a .ply of Gaussians, truncated, or a property is missing.
    """
    elements = read_elements(path)
    if "vertex" not in elements:
        raise InputError(
            f"{path}: element 'vertex' of plain numbers is missing; expected Gaussians"
        )
    if is_compressed(elements):
        return decompressed(path, elements)
    table = elements["vertex"]
    names = table.dtype.names or ()
    rest = sum(name.startswith("f_rest_") for name in names)
    try:
        degree_of(1 + rest // 3 if rest % 3 == 0 else -1)
    except ValueError:
        found = f"{rest} properties f_rest; expected 0, 9, 24, 45 or 72"
        raise InputError(f"{path}: {found}") from None
    if not set(names) & set(_GEOMETRY):
        raise InputError(f"{path}: holds points or a mesh; expected Gaussians, as 3DGS writes them")
    plain = "f_dc_0" not in names and set(_RGB) <= set(names)
    optional = {"nx", "ny", "nz", "scale_2", *(_DC if plain else ())}
    for name in _properties(1 + rest // 3):
        if name not in names and name not in optional:
            raise InputError(f"{path}: property '{name}' is missing; expected Gaussians")
    pick = lambda *wanted: np.stack([table[name] for name in wanted], axis=1).astype(np.float32)
    numbered = lambda name, n: pick(*(f"{name}_{i}" for i in range(n)))
    log_scales = numbered("scale", 3 if "scale_2" in names else 2)  # 2DGS: no thickness
    if plain:
        colors = {"colors": pick(*_RGB) / np.float32([_white(table.dtype[name]) for name in _RGB])}
    else:
        higher = numbered("f_rest", rest) if rest else np.zeros((len(table), 0), np.float32)
        colors = {"sh": from_rest(numbered("f_dc", 3), higher)}
    opacities = torch.sigmoid(torch.from_numpy(pick("opacity")[:, 0])).numpy()
    scales = torch.exp(torch.from_numpy(log_scales))
    return gaussians_of(
        means=pick("x", "y", "z"),
        quats=numbered("rot", 4),
        scales=torch.nn.functional.pad(scales, (0, 3 - scales.shape[1])).numpy(),
        opacities=opacities,
        **colors,
    )


def _white(dtype: np.dtype) -> float:
    """The number that means 1 in a colour of this type."""
    return 1.0 if dtype.kind == "f" else float(np.iinfo(dtype).max)


def _properties(coefficients: int) -> list[str]:
    """Columns of a file whose colours have so many SH coefficients."""
    rest = [f"f_rest_{i}" for i in range(3 * (coefficients - 1))]
    return ["x", "y", "z", "nx", "ny", "nz", *_DC, *rest, *_GEOMETRY]


CHUNK = 256  # Gaussians
PACKED = tuple(f"packed_{name}" for name in ("position", "rotation", "scale", "color"))
REST = (9, 24, 45)  # properties of "sh"
_PLACE, _COLOR, _ROTATION = (11, 10, 11), (8, 8, 8, 8), (2, 10, 10, 10)  # bits
# Bounds of a chunk: names of the minima, then of the maxima.
_MEANS, _SCALES, _COLORS = (
    [f"{end}_{kind}{axis}" for end in ("min", "max") for axis in axes]
    for kind, axes in (("", "xyz"), ("scale_", "xyz"), ("", "rgb"))
)
_MAX_LOG_SCALE = 20.0  # of either sign; SuperSplat's own bounds
_MORTON_BITS = 10  # of each axis


def is_compressed(elements: dict[str, np.ndarray]) -> bool:
    """Whether the tables of a .ply are in the compressed format."""
    return "vertex" in elements and PACKED[0] in elements["vertex"].dtype.names


def decompressed(path: Path, elements: dict[str, np.ndarray]) -> Gaussians:
    """Decode the Gaussians in the tables of a compressed .ply.

    Raises:
        InputError: a table or property is missing or does not fit, or a number is not finite.
    """
    vertex, chunk = elements["vertex"], _chunks_of(path, elements)
    position, rotation, scale, color = (vertex[name] for name in PACKED)
    rgba, (largest, *others) = _shares(color, _COLOR), unpack(rotation, _ROTATION).T
    rgb = rgba[:, :3]
    if _COLORS[0] in chunk.dtype.names:
        rgb = _between(chunk, _COLORS, rgb)
    with np.errstate(over="ignore"):
        scales = np.exp(_between(chunk, _SCALES, _shares(scale, _PLACE))).astype(np.float32)
    means = _between(chunk, _MEANS, _shares(position, _PLACE))
    sh = from_rest((rgb - 0.5) / C0, _rest_of(path, elements))
    if not all(np.isfinite(numbers).all() for numbers in (means, scales, sh)):
        raise InputError(f"{path}: a chunk's bounds are not finite, or too large")
    quats = with_largest(largest, (2 * (np.column_stack(others) / 1023) - 1) * np.sqrt(0.5))
    return gaussians_of(means=means, quats=quats, scales=scales, opacities=rgba[:, 3], sh=sh)


def save_compressed_ply(path: Path, gaussians: Gaussians) -> None:
    """Write Gaussians of torch tensors, rounded to the format's bits, in another order.

    Raises:
        InputError: harmonics of degree 4, which the format lacks, or numbers that are not finite.
    """
    stored = Stored.of(path, gaussians, "a compressed .ply", most=3)
    scales = np.clip(stored.log_scales, -_MAX_LOG_SCALE, _MAX_LOG_SCALE)
    order = _morton(stored.means)
    columns = (stored.means, scales, stored.sh[:, 0] * C0 + 0.5)
    bounds, shares = zip(*(_in_chunks(x[order]) for x in columns), strict=True)
    rgba = np.column_stack([shares[2], np.clip(stored.opacities[order], 0, 1)])
    largest, others = without_largest(stored.unit_quats[order])
    others = np.floor(np.clip(others * np.sqrt(0.5) + 0.5, 0, 1) * 1023 + 0.5)
    vertex = np.column_stack(
        [
            _packed(shares[0], _PLACE),
            pack(np.column_stack([largest, others]), _ROTATION),
            _packed(shares[1], _PLACE),
            _packed(rgba, _COLOR),
        ]
    )
    rest = stored.rest[order]
    tables = [
        ("chunk", "float", _MEANS + _SCALES + _COLORS, np.concatenate(bounds, axis=1)),
        ("vertex", "uint", PACKED, vertex),
    ]
    if rest.shape[1]:
        byte = np.clip(np.floor((rest / 8 + 0.5) * 256), 0, 255)
        tables.append(("sh", "uchar", [f"f_rest_{i}" for i in range(rest.shape[1])], byte))
    write_bytes(path, *ply_parts(tables))


def _chunks_of(path: Path, elements: dict[str, np.ndarray]) -> np.ndarray:
    """Check the tables, and return the chunk of each Gaussian, (N,)."""
    vertex, chunk = elements["vertex"], elements.get("chunk")
    if chunk is None:
        raise InputError(f"{path}: element 'chunk' is missing; expected a compressed .ply")
    bounds = _MEANS + _SCALES + (_COLORS if _COLORS[0] in chunk.dtype.names else [])
    _require(path, "vertex", vertex, PACKED, "uint")
    _require(path, "chunk", chunk, bounds, "float")
    count = -(-len(vertex) // CHUNK)
    if len(chunk) != count:
        found = f"{len(chunk)} chunks of {len(vertex)} Gaussians"
        raise InputError(f"{path}: {found}; expected {count}, one for every {CHUNK}")
    return chunk[np.arange(len(vertex)) // CHUNK]


def _require(path: Path, element: str, table: np.ndarray, names: Sequence[str], kind: str) -> None:
    """Check that a table has all properties, in the right type."""
    for name in names:
        if name not in (table.dtype.names or ()) or table.dtype[name] != np.dtype(TYPES[kind]):
            raise InputError(
                f"{path}: property '{name}' of '{element}' is missing; expected it as {kind}, "
                "as SuperSplat writes a compressed .ply"
            )


def _rest_of(path: Path, elements: dict[str, np.ndarray]) -> np.ndarray:
    """Decode the coefficients above the constant one, (N, 3 (K - 1))."""
    vertex, table = elements["vertex"], elements.get("sh")
    if table is None:
        return np.zeros((len(vertex), 0))
    count = len(table.dtype.names or ())
    if len(table) != len(vertex) or count not in REST:
        found = f"{len(table)} rows of {count} in 'sh'"
        raise InputError(f"{path}: {found}; expected {len(vertex)} of 9, 24 or 45")
    names = [f"f_rest_{i}" for i in range(count)]
    _require(path, "sh", table, names, "uchar")
    byte = np.column_stack([table[name] for name in names]).astype(np.float64)
    return 8 * np.where(byte == 0, 0, np.where(byte == 255, 1, (byte + 0.5) / 256)) - 4


def _shares(packed: np.ndarray, bits: tuple[int, ...]) -> np.ndarray:
    """Unpack numbers in [0, 1] of so many bits each, (N, len(bits))."""
    return unpack(packed, bits) / ((1 << np.array(bits)) - 1)


def _packed(shares: np.ndarray, bits: tuple[int, ...]) -> np.ndarray:
    """Invert :func:`_shares`."""
    return pack(np.floor(shares * ((1 << np.array(bits)) - 1) + 0.5), bits)


def _between(chunk: np.ndarray, names: Sequence[str], share: np.ndarray) -> np.ndarray:
    """Interpolate between the bounds of each Gaussian's chunk by ``share`` (N, 3)."""
    bounds = np.column_stack([chunk[name] for name in names]).astype(np.float64)
    return bounds[:, :3] * (1 - share) + bounds[:, 3:] * share


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
