"""The .splat of browser viewers (antimatter15's): reader and writer, 32 bytes a Gaussian.

    means 3 float32 · scales 3 float32 · rgb and opacity 4 uint8 · quaternion 4 uint8

* no header, little-endian; scales are standard deviations, not logarithms;
* a quaternion wxyz of length one is stored as q 128 + 128;
* the largest and most opaque come first, because viewers draw while the rest loads.

It holds one colour a Gaussian: view-dependent colour is dropped.

---
Niantic's .spz, at most a quarter of a .ply: reader of versions 2 to 4, writer of version 3.

Versions 2 and 3 are one gzip stream: a header of 16 bytes, then all Gaussians' positions, then all
opacities, and so on. Version 4 has a header of 32 bytes and compresses each of these streams with
zstd. Most viewers read version 3.

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

Version 2 stores quaternions xyz in 3 × 8 bits. Harmonics keep all 8 bits here; Niantic's own
program drops three or four. In a file y is up and z points to the viewer, if no extension of Adobe
says otherwise. Readers of this package return, and its writers take, the axes of the .ply of 3DGS
(:mod:`gva_mi.splat.axes`).
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
from gva_mi.splat.axes import half_turned, with_signs
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
_HEADER_4 = struct.Struct(
    "<IIIBBBBI12x"
)  # the last two: number of streams, and offset of their sizes
_ANTIALIASED = 1  # the flag of opacities fitted with Mip-Splatting's filter
_EXTENDED = 2  # the flag of extensions: behind the streams, in version 4 before them
_HARMONICS, _AXES = 0xADBE0001, 0xADBE0003  # Adobe's extensions: another range, other axes
_SYSTEMS = (
    "RUB LDB RDB LUB RUB LDF RDF LUF RUF LFD RFD LFU RFU LBD RBD LBU RBU".split()
)  # where x, y, z point: right, up, down, back to the viewer, ...; without a number the usual ones
_EXTENSIONS = 4096  # bytes that are looked at
_MAX_24_BIT = 0x7FFFFF  # signed
_COLOR = 0.15
_ROTATION = (2, 10, 10, 10)  # bits of a quaternion
_HALF = np.sqrt(0.5)  # bound of all components but the largest
_MAX_RATIO = 1100  # gzip and zstd compress such a file no further
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
    header = _HEADER.pack(MAGIC, 3, len(means), stored.degree, bits, flags, 0)
    content = header + b"".join(stream.tobytes() for stream in streams)
    write_bytes(path, gzip.compress(content, mtime=0))  # the same bytes every time


def load_spz(path: Path) -> Gaussians:
    """Read a .spz of version 2, 3 or 4.

    Raises:
        InputError: no such file, another format or version, or truncated.
    """
    content = read_bytes(path, "a .spz")
    packed = content[:2] == b"\x1f\x8b"
    head = _unzipped(path, content, _HEADER.size) if packed else content[: _HEADER_4.size]
    if len(head) < (_HEADER.size if packed else _HEADER_4.size):
        raise InputError(f"{path}: {len(content)} bytes; expected a .spz")
    magic, version, count, degree, bits, flags, *_ = (_HEADER if packed else _HEADER_4).unpack(head)
    if magic != MAGIC or version not in ((2, 3) if packed else (4,)):
        kind = known_container(path)
        other = f"something else, {kind}" if kind else "something else"
        found = f"version {version}" if magic == MAGIC else other
        raise InputError(f"{path}: holds {found}; expected a .spz of version 2, 3 or 4")
    widths = (9, 1, 3, 3, 3 if version == 2 else 4, 3 * (degree + 1) ** 2 - 3)
    sizes = [count * width for width in widths]
    if degree > 4 or bits > 23 or count > _MAX_COUNT or sum(sizes) > _MAX_RATIO * len(content):
        raise InputError(
            f"{path}: announces {count} Gaussians of degree {degree} with {bits} bits in "
            f"{len(content)} bytes; expected a .spz"
        )
    if packed:
        body = _unzipped(path, content, _HEADER.size + sum(sizes) + _EXTENSIONS)[_HEADER.size :]
        ends, more = np.cumsum(sizes), body[sum(sizes) :]
        streams = [body[end - size : end] for size, end in zip(sizes, ends, strict=True)]
    else:
        streams = _of_version_4(path, content, sizes)
        more = content[_HEADER_4.size : _HEADER_4.unpack(head)[-1]][:_EXTENSIONS]
    signs = _signs(path, more if flags & _EXTENDED else b"")
    if any(len(stream) != size for stream, size in zip(streams, sizes, strict=True)):
        raise InputError(f"{path}: cut short, {count} Gaussians were announced")
    rows = [
        np.frombuffer(stream, "u1").reshape(count, width)
        for stream, width in zip(streams, widths, strict=True)
    ]
    found = with_signs(_gaussians(rows, bits, version), signs)
    return replace(found, antialiased=bool(flags & _ANTIALIASED))


def _gaussians(rows: list[np.ndarray], bits: int, version: int) -> Gaussians:
    """Decode the streams' bytes (N, n)."""
    means, opacities, colors, scales, quats, sh = rows
    fixed = np.zeros((len(means), 3, 4), "u1")
    fixed[..., 1:] = means.reshape(-1, 3, 3)  # in the upper bytes, for the sign
    dc = (colors / 255 - 0.5) / _COLOR
    higher = (sh.reshape(len(sh), sh.shape[1] // 3, 3) - 128.0) / 128
    return gaussians_of(
        means=(fixed.view("<i4")[..., 0] >> 8) / 2.0**bits,
        quats=_of_first_three(quats) if version == 2 else _of_smallest_three(quats),
        scales=np.exp(scales / 16 - 10),
        opacities=opacities[:, 0] / 255,
        sh=np.concatenate([dc[:, None], higher], axis=1),
    )


def _signs(path: Path, extensions: bytes) -> tuple[int, int, int]:
    """Return the signs that lead from a file's axes to those of a .ply: right, down, forward.

    ``extensions`` are records of a type, a length, and so many bytes.
    """
    system, at = 0, 0
    while at + 8 <= len(extensions):
        kind, length = struct.unpack_from("<II", extensions, at)
        if kind == _AXES and length == 4 and at + 12 <= len(extensions):
            (system,) = struct.unpack_from("<I", extensions, at + 8)
        elif kind in (_HARMONICS, _AXES):
            raise InputError(
                f"{path}: Adobe's extension {kind:#x} of {length} bytes says that its harmonics or "
                "axes mean something else, which is not read; expected a .spz without it"
            )
        at += 8 + length
    axes = _SYSTEMS[system] if system < len(_SYSTEMS) else f"number {system}"
    if axes[0] not in "LR" or axes[1] not in "UD" or axes[2] not in "BF":
        raise InputError(
            f"{path}: an extension says that its axes are {axes}; expected y up or down, such as "
            "RUB (right, up, back) or RDF"
        )
    return tuple(1 if axis in "RDF" else -1 for axis in axes)


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


def _of_first_three(stored: np.ndarray) -> np.ndarray:
    """Unpack unit quaternions wxyz (N, 4) of xyz in a byte each; w is not negative."""
    xyz = stored / 127.5 - 1
    return np.column_stack([np.sqrt(np.maximum(1 - (xyz**2).sum(1), 0)), xyz])


def _unzipped(path: Path, content: bytes, most: int) -> bytes:
    """Decompress at most so many bytes of a gzip stream."""
    try:
        return zlib.decompressobj(wbits=31).decompress(content, most)
    except zlib.error as error:
        raise InputError(f"{path}: damaged ({error}); expected a .spz") from None


def _of_version_4(path: Path, content: bytes, sizes: list[int]) -> list[bytes]:
    """Decompress the streams of a version 4 file."""
    try:
        import zstandard
    except ModuleNotFoundError:
        raise InputError(
            f"{path}: a .spz of version 4 needs the package zstandard to be read; "
            "pip install zstandard"
        ) from None
    number, start = _HEADER_4.unpack(content[: _HEADER_4.size])[-2:]
    toc = content[start : start + 16 * number]
    expected = (
        {len(sizes)} if sizes[-1] else {len(sizes) - 1, len(sizes)}
    )  # the last may be left out
    if number not in expected or len(toc) < 16 * number:
        raise InputError(f"{path}: holds {number} streams; expected the {len(sizes)} of a .spz")
    streams, start = [], start + 16 * number
    for (packed, _), size in zip(struct.iter_unpack("<QQ", toc), sizes, strict=False):
        try:
            source = zstandard.ZstdDecompressor().stream_reader(content[start : start + packed])
            streams.append(source.read(size))
        except zstandard.ZstdError as error:
            raise InputError(f"{path}: damaged ({error}); expected a .spz") from None
        start += packed
    return streams + [b""] * (len(sizes) - number)
