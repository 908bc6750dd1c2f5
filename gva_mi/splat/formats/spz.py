"""Writers of files for viewers in a browser: Niantic's .spz and antimatter15's .splat.

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
points to the viewer. The writers take Gaussians in the axes of the .ply of
3DGS (:mod:`gva_mi.splat.axes`).
"""

from __future__ import annotations

import gzip
import struct
from pathlib import Path

import numpy as np

from gva_mi.core.atomic import write_bytes
from gva_mi.core.errors import InputError
from gva_mi.splat.axes import half_turned
from gva_mi.splat.formats.stored import Stored, pack, to_bytes, without_largest
from gva_mi.splat.gaussians import Gaussians
from gva_mi.splat.kernels.sh import C0

# 32 bytes.
ROW = np.dtype([("means", "<f4", 3), ("scales", "<f4", 3), ("rgba", "u1", 4), ("quats", "u1", 4)])


def save_splat(path: Path, gaussians: Gaussians) -> None:
    """Write Gaussians of torch tensors as a .splat, rounded to the format's 8 bits.

    Raises:
        InputError: numbers that are not finite.

    Example:
        >>> from tempfile import TemporaryDirectory
        >>> import torch
        >>> from gva_mi.splat.scene import random_scene
        >>> g = random_scene(torch.Generator().manual_seed(0), gaussians=5).gaussians
        >>> with TemporaryDirectory() as folder:
        ...     save_splat(Path(folder, "five.splat"), g)
        ...     Path(folder, "five.splat").stat().st_size
        160
    """
    stored = Stored.of(path, gaussians)
    rows = np.zeros(len(gaussians), ROW)
    rows["means"], rows["scales"] = stored.means, stored.scales
    rows["rgba"] = to_bytes(255 * np.column_stack([plain_colors(gaussians), stored.opacities]))
    rows["quats"] = to_bytes(128 * stored.unit_quats + 128)
    order = np.argsort(-stored.scales.prod(1) * stored.opacities, kind="stable")
    write_bytes(path, rows[order].tobytes())


def plain_colors(gaussians: Gaussians) -> np.ndarray:
    """Return view-independent colours (N, 3) in [0, 1].

    Example:
        >>> import torch
        >>> one = torch.ones(1)
        >>> g = Gaussians(torch.zeros(1, 3), one, one, one, sh=torch.zeros(1, 4, 3))
        >>> plain_colors(g).tolist()
        [[0.5, 0.5, 0.5]]
    """
    if gaussians.sh is None:
        colors = gaussians.colors.detach().double().numpy()
    else:
        colors = gaussians.sh[:, 0].detach().double().numpy() * C0 + 0.5
    return np.clip(colors, 0, 1)


# Niantic's github.com/nianticlabs/spz, version 3, unless said otherwise
MAGIC = 0x5053474E  # NGSP
MAX_FRACTION_BITS = 16  # of means: chosen, rounding error 8 µm within ±128 m
_HEADER = struct.Struct("<IIIBBBB")  # magic, version, Gaussians, degree, f, flags, reserved
_VERSION = 3
_MAX_24_BIT = 0x7FFFFF  # signed
_COLOR_COEFFICIENT_SCALE = 0.15  # s of a coefficient c of degree 0: byte = 255 (s c + 0.5)
_QUATERNION_BITS = (2, 10, 10, 10)
_ROOT_HALF = np.sqrt(0.5)  # bound of all components of a unit quaternion but the largest


def save_spz(path: Path, gaussians: Gaussians) -> None:
    """Write Gaussians of torch tensors as .spz of version 3, rounded to the format's bits.

    Raises:
        InputError: harmonics of degree 4, which version 3 lacks, means beyond 8,388 km, or numbers
            that are not finite.

    Example:
        >>> from tempfile import TemporaryDirectory
        >>> import torch
        >>> from gva_mi.splat.scene import random_scene
        >>> g = random_scene(torch.Generator().manual_seed(0), gaussians=5).gaussians
        >>> with TemporaryDirectory() as folder:
        ...     save_spz(Path(folder, "five.spz"), g)
        ...     gzip.decompress(Path(folder, "five.spz").read_bytes())[:4]
        b'NGSP'
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
        to_bytes(255 * (_COLOR_COEFFICIENT_SCALE * stored.sh[:, 0] + 0.5)),
        to_bytes(16 * (stored.log_scales + 10)),
        _smallest_three(stored.unit_quats),
        to_bytes(128 * stored.sh[:, 1:] + 128),
    ]
    header = _HEADER.pack(MAGIC, _VERSION, len(means), stored.degree, bits, 0, 0)
    content = header + b"".join(stream.tobytes() for stream in streams)
    write_bytes(path, gzip.compress(content, mtime=0))  # the same bytes every time


def _smallest_three(quats: np.ndarray) -> np.ndarray:
    """Pack unit quaternions wxyz (N, 4) into 32 bits each, without the largest of x, y, z, w."""
    largest, others = without_largest(quats[:, [1, 2, 3, 0]])
    sizes = np.round(511 * np.minimum(np.abs(others) / _ROOT_HALF, 1)).astype(np.int64)
    return pack(np.column_stack([largest, (others < 0) << 9 | sizes]), _QUATERNION_BITS)
