"""The .ply of 3D Gaussian Splatting: reader and writer.

One binary little-endian vertex per Gaussian, all float32, in the order of the original code:

    x y z · nx ny nz · f_dc_0..2 · f_rest_0.. · opacity · scale_0..2 · rot_0..3

* normals are zero, ``opacity`` is a logit, ``scale`` a logarithm, ``rot`` a quaternion wxyz;
* f_rest goes channel by channel: all red coefficients, then green, then blue;
* y is down and z forward (:mod:`gva_mi.splat.axes`).

The reader also takes text, big-endian numbers and any type, ``red green blue`` instead of f_dc, and
the flat Gaussians of 2D Gaussian Splatting, which have no ``scale_2``.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from gva_mi.core.atomic import write_bytes
from gva_mi.core.errors import InputError
from gva_mi.splat.formats.compressed_ply import decompressed, is_compressed
from gva_mi.splat.formats.ply_elements import ply_parts, read_elements
from gva_mi.splat.formats.stored import Stored, from_rest, gaussians_of
from gva_mi.splat.gaussians import Gaussians, degree_of

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
