"""The .splat of browser viewers (antimatter15's): reader and writer, 32 bytes a Gaussian.

    means 3 float32 · scales 3 float32 · rgb and opacity 4 uint8 · quaternion 4 uint8

* no header, little-endian; scales are standard deviations, not logarithms;
* a quaternion wxyz of length one is stored as q 128 + 128;
* the largest and most opaque come first, because viewers draw while the rest loads.

It holds one colour a Gaussian: view-dependent colour is dropped.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from gva_mi.core.atomic import write_bytes
from gva_mi.core.errors import InputError
from gva_mi.core.files import known_container, read_bytes
from gva_mi.splat.formats.stored import Stored, gaussians_of, to_bytes
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
