"""Files for viewers in a browser: Niantic's .spz and antimatter15's .splat.

The .splat has 32 bytes a Gaussian, without a header, little-endian:

    means 3 float32 · scales 3 float32 · rgb and opacity 4 uint8 · quaternion 4 uint8

* scales are standard deviations, not logarithms; a quaternion wxyz of length one is q 128 + 128;
* the largest and most opaque come first, because viewers draw while the rest loads;
* it holds one colour a Gaussian: view-dependent colour is dropped.

The .spz is at most a quarter of a .ply: one gzip stream with a header of 16 bytes, then all
Gaussians' positions, then all opacities, and so on. This is version 3, which most viewers read.

============  ==============================  ===========================  ======================
Stream        Stored, little-endian           Means                        Rounding error
============  ==============================  ===========================  ======================
means         3 × 24-bit, signed              i / 2^f, f of the header     2^−f / 2, where
                                                                           |x| < 2^(23−f)
opacities     8-bit                           b / 255                      0.5 / 255
colours       3 × 8-bit                       f_dc = (b/255 − 0.5) / 0.15  0.5 / 38.25 of f_dc in
                                                                           ±3.33
scales        3 × 8-bit                       exp(b/16 − 10) metres        3.2 %, from 45 µm to
                                                                           380 m
quaternions   the largest's number, 2 bits;   x 2^−½ / 511, the sign in    0.28 degrees
              the others, 3 × 10 bits         the tenth bit
harmonics     8-bit each, colours innermost   (b − 128) / 128              0.5 / 128 in [−1, 0.99]
============  ==============================  ===========================  ======================

Harmonics keep all 8 bits here; Niantic's own program drops three or four. In a file y is up and z
points to the viewer. Readers of this package return, and its writers take, the axes of the .ply of
3DGS (:mod:`gva_mi.splat.axes`).
"""

from __future__ import annotations

import gzip
import struct
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np

from gva_mi.core.atomic import write_bytes
from gva_mi.core.errors import InputError
from gva_mi.core.files import known_container, read_bytes
from gva_mi.splat.axes import half_turned
from gva_mi.splat.formats.stored import (
    Stored,
    gaussians_of,
    pack,
    to_bytes,
    unpack,
    with_largest,
    without_largest,
)
from gva_mi.splat.gaussians import Gaussians
from gva_mi.splat.kernels.sh import C0

ROW = np.dtype(
    [("means", "<f4", 3), ("scales", "<f4", 3), ("rgba", "u1", 4), ("quats", "u1", 4)]
)  # 32 bytes


def save_splat(path: Path, gaussians: Gaussians) -> None:
    """Write Gaussians of torch tensors, rounded to the format's 8 bits.

    Raises:
        InputError: numbers that are not finite.
    """
    stored = Stored.of(path, gaussians)
    rows = np.zeros(len(gaussians), ROW)
    rows["means"], rows["scales"] = stored.means, stored.scales
    rows["rgba"] = to_bytes(255 * np.column_stack([plain_colors(gaussians), stored.opacities]))
    rows["quats"] = to_bytes(128 * stored.unit_quats + 128)
    order = np.argsort(-stored.scales.prod(1) * stored.opacities, kind="stable")
    write_bytes(path, rows[order].tobytes())


def load_splat(path: Path) -> Gaussians:
    """Read a .splat.

    Raises:
        InputError: no such file, a length that is no multiple of 32 bytes, or numbers that are not
            finite.
    """
    content = read_bytes(path, "a .splat")
    found = known_container(path)
    if found is None and len(content) % ROW.itemsize:
        found = f"{len(content)} bytes"
    if found:
        raise InputError(f"{path}: {found}; expected a .splat, {ROW.itemsize} bytes a Gaussian")
    rows = np.frombuffer(content, ROW)
    if not (np.isfinite(rows["means"]).all() and np.isfinite(rows["scales"]).all()):
        raise InputError(f"{path}: holds numbers that are not finite; expected a .splat")
    rgba = rows["rgba"].astype(np.float32) / 255
    return gaussians_of(
        means=rows["means"],
        quats=(rows["quats"].astype(np.float32) - 128) / 128,
        scales=np.abs(rows["scales"]),  # viewers square them
        opacities=rgba[:, 3],
        colors=rgba[:, :3],
    )


def plain_colors(gaussians: Gaussians) -> np.ndarray:
    """Return view-independent colours (N, 3) in [0, 1]."""
    if gaussians.sh is None:
        colors = gaussians.colors.detach().double().numpy()
    else:
        colors = gaussians.sh[:, 0].detach().double().numpy() * C0 + 0.5
    return np.clip(colors, 0, 1)


MAGIC = 0x5053474E  # NGSP
MAX_FRACTION_BITS = 16  # of means: rounding error 8 µm within ±128 m
_HEADER = struct.Struct("<IIIBBBB")  # magic, version, Gaussians, degree, f, flags, reserved
_VERSION = 3
_ANTIALIASED = 1  # the flag of opacities fitted with Mip-Splatting's filter
_EXTENDED = 2  # the flag of extensions, which may mean other axes or another range
_MAX_24_BIT = 0x7FFFFF  # signed
_COLOR = 0.15
_ROTATION = (2, 10, 10, 10)  # bits of a quaternion
_HALF = np.sqrt(0.5)  # bound of all components but the largest
_MAX_RATIO = 1100  # gzip compresses such a file no further
_MAX_COUNT = 1 << 26  # Gaussians


def save_spz(path: Path, gaussians: Gaussians) -> None:
    """Write Gaussians of torch tensors as version 3, rounded to the format's bits.

    Raises:
        InputError: harmonics of degree 4, which version 3 lacks, means beyond 8,388 km, or numbers
            that are not finite.
    """
    stored = Stored.of(path, half_turned(gaussians), "a .spz", most=3)
    means = stored.means
    farthest = float(np.abs(means).max(initial=0))
    if not farthest < _MAX_24_BIT:
        raise InputError(f"{path}: a .spz holds means up to {_MAX_24_BIT} m, got {farthest:.4g}")
    bits = int(np.clip(np.floor(np.log2(_MAX_24_BIT / max(farthest, 1e-9))), 0, MAX_FRACTION_BITS))
    fixed = np.round(means * 2**bits).astype("<i4")
    streams = [
        np.ascontiguousarray(fixed).view("u1").reshape(len(means), 3, 4)[..., :3],
        to_bytes(255 * stored.opacities),
        to_bytes(255 * (_COLOR * stored.sh[:, 0] + 0.5)),
        to_bytes(16 * (stored.log_scales + 10)),
        _smallest_three(stored.unit_quats),
        to_bytes(128 * stored.sh[:, 1:] + 128),
    ]
    flags = _ANTIALIASED if gaussians.antialiased else 0
    header = _HEADER.pack(MAGIC, _VERSION, len(means), stored.degree, bits, flags, 0)
    content = header + b"".join(stream.tobytes() for stream in streams)
    write_bytes(path, gzip.compress(content, mtime=0))  # the same bytes every time


def load_spz(path: Path) -> Gaussians:
    """Read a .spz of version 3.

    Raises:
        InputError: no such file, another format or version, or truncated.
    """
    content = read_bytes(path, "a .spz")
    head = _unzipped(path, content, _HEADER.size)
    magic, version, count, degree, bits, flags, _ = _HEADER.unpack(head)
    if magic != MAGIC or version != _VERSION or flags & _EXTENDED:
        what = f"version {version}" + " with extensions" * bool(flags & _EXTENDED)
        found = what if magic == MAGIC else "something else"
        raise InputError(f"{path}: holds {found}; expected a .spz of version {_VERSION}")
    widths = (9, 1, 3, 3, 4, 3 * (degree + 1) ** 2 - 3)
    size = count * sum(widths)
    if degree > 4 or bits > 23 or count > _MAX_COUNT or size > _MAX_RATIO * len(content):
        raise InputError(
            f"{path}: announces {count} Gaussians of degree {degree} with {bits} bits in "
            f"{len(content)} bytes; expected a .spz"
        )
    body = np.frombuffer(_unzipped(path, content, _HEADER.size + size), "u1")[_HEADER.size :]
    streams = np.split(body, np.cumsum([count * width for width in widths[:-1]]))
    rows = [stream.reshape(count, width) for stream, width in zip(streams, widths, strict=True)]
    means, opacities, colors, scales, quats, sh = rows
    fixed = np.zeros((count, 3, 4), "u1")
    fixed[..., 1:] = means.reshape(-1, 3, 3)  # in the upper bytes, for the sign
    dc = (colors / 255 - 0.5) / _COLOR
    higher = (sh.reshape(count, widths[-1] // 3, 3) - 128.0) / 128
    found = gaussians_of(
        means=(fixed.view("<i4")[..., 0] >> 8) / 2.0**bits,
        quats=_of_smallest_three(quats),
        scales=np.exp(scales / 16 - 10),
        opacities=opacities[:, 0] / 255,
        sh=np.concatenate([dc[:, None], higher], axis=1),
    )
    return replace(half_turned(found), antialiased=bool(flags & _ANTIALIASED))


def _smallest_three(quats: np.ndarray) -> np.ndarray:
    """Pack unit quaternions wxyz (N, 4) into 32 bits each, without the largest of x, y, z, w."""
    largest, others = without_largest(quats[:, [1, 2, 3, 0]])
    sizes = np.round(511 * np.minimum(np.abs(others) / _HALF, 1)).astype(np.int64)
    return pack(np.column_stack([largest, (others < 0) << 9 | sizes]), _ROTATION)


def _of_smallest_three(stored: np.ndarray) -> np.ndarray:
    """Unpack unit quaternions wxyz (N, 4) of 4 bytes each."""
    largest, *others = unpack(np.ascontiguousarray(stored).view("<u4")[:, 0], _ROTATION).T
    others = np.column_stack(others)
    sizes = (others & 511) * (_HALF / 511)
    return with_largest(largest, np.where(others >> 9, -sizes, sizes))[:, [3, 0, 1, 2]]


def _unzipped(path: Path, content: bytes, size: int) -> bytes:
    """Decompress the first ``size`` bytes of a gzip stream."""
    found = known_container(path)
    if content[:2] != b"\x1f\x8b":
        raise InputError(f"{path}: holds {found or 'something else'}; expected a .spz")
    try:
        head = zlib.decompressobj(wbits=31).decompress(content, size)
    except zlib.error as error:
        raise InputError(f"{path}: damaged ({error}); expected a .spz") from None
    if len(head) < size:
        raise InputError(f"{path}: cut short; expected a .spz")
    return head
