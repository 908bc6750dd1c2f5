"""The .ply of 3D Gaussian Splatting: reader and writer.

One little-endian vertex per Gaussian, all float32, in the order of the original code:

    x y z · nx ny nz · f_dc_0..2 · f_rest_0.. · opacity · scale_0..2 · rot_0..3

* normals are zero, ``opacity`` is a logit, ``scale`` a logarithm, ``rot`` a quaternion wxyz;
* f_rest goes channel by channel: all red coefficients, then green, then blue;
* y is down and z forward (:mod:`gva_mi.splat.axes`).

The reader takes the properties in any order and of any type, and the flat Gaussians of 2D Gaussian
Splatting, which have no ``scale_2``. Its vertices must be the first element of a binary file.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import torch

from gva_mi.core.atomic import write_bytes
from gva_mi.core.errors import InputError
from gva_mi.core.files import known_container, read_bytes
from gva_mi.splat.formats.stored import Stored, from_rest, gaussians_of
from gva_mi.splat.gaussians import Gaussians, degree_of

TYPES = {  # each has two names
    **dict.fromkeys(("char", "int8"), "<i1"),
    **dict.fromkeys(("uchar", "uint8"), "<u1"),
    **dict.fromkeys(("short", "int16"), "<i2"),
    **dict.fromkeys(("ushort", "uint16"), "<u2"),
    **dict.fromkeys(("int", "int32"), "<i4"),
    **dict.fromkeys(("uint", "uint32"), "<u4"),
    **dict.fromkeys(("float", "float32"), "<f4"),
    **dict.fromkeys(("double", "float64"), "<f8"),
}
_FORMAT = "binary_little_endian 1.0"
_GEOMETRY = ["opacity", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
_OPTIONAL = {"nx", "ny", "nz", "scale_2"}
_LOGIT_MARGIN = 1e-7  # of opacities to 0 and 1, whose logits are infinite: float32's spacing there


def save_ply(path: Path, gaussians: Gaussians) -> None:
    """Write Gaussians of torch tensors in the format of 3DGS.

    Plain colours become the constant band of the harmonics.

    Raises:
        InputError: numbers that are not finite.

    Example:
        >>> from tempfile import TemporaryDirectory
        >>> from gva_mi.splat.scene import random_scene
        >>> g = random_scene(torch.Generator().manual_seed(0), gaussians=5, degree=1).gaussians
        >>> with TemporaryDirectory() as folder:
        ...     save_ply(Path(folder, "five.ply"), g)
        ...     read = load_ply(Path(folder, "five.ply"))
        >>> tuple(read.sh.shape), bool(torch.allclose(read.scales, g.scales.float()))
        ((5, 4, 3), True)
    """
    stored = Stored.of(path, gaussians)
    eta = np.clip(stored.opacities, _LOGIT_MARGIN, 1 - _LOGIT_MARGIN)
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
    header = ["ply", f"format {_FORMAT}", f"element vertex {len(table)}"]
    header += [f"property float {name}" for name in _properties(stored.sh.shape[1])]
    text = "\n".join([*header, "end_header\n"])
    write_bytes(path, text.encode("ascii"), table.astype("<f4").tobytes())


def load_ply(path: Path) -> Gaussians:
    """Read a .ply of 3DGS or 2DGS.

    Raises:
        InputError: not a .ply of Gaussians, truncated, or a property is missing.

    Example:
        >>> load_ply(Path("missing.ply"))
        Traceback (most recent call last):
        ...
        gva_mi.core.errors.InputError: missing.ply: no such file; expected a .ply of Gaussians
    """
    table = _read_vertices(path)
    names = table.dtype.names or ()
    rest = sum(name.startswith("f_rest_") for name in names)
    try:
        degree_of(1 + rest // 3 if rest % 3 == 0 else -1)
    except ValueError:
        found = f"{rest} properties f_rest; expected 0, 9, 24, 45 or 72"
        raise InputError(f"{path}: {found}") from None
    if not set(names) & set(_GEOMETRY):
        raise InputError(f"{path}: holds points or a mesh; expected Gaussians, as 3DGS writes them")
    for name in _properties(1 + rest // 3):
        if name not in names and name not in _OPTIONAL:
            raise InputError(f"{path}: property '{name}' is missing; expected Gaussians")
    pick = lambda *wanted: np.stack([table[name] for name in wanted], axis=1).astype(np.float32)
    numbered = lambda name, n: pick(*(f"{name}_{i}" for i in range(n)))
    log_scales = numbered("scale", 3 if "scale_2" in names else 2)  # 2DGS: no thickness
    higher = numbered("f_rest", rest) if rest else np.zeros((len(table), 0), np.float32)
    scales = torch.exp(torch.from_numpy(log_scales))
    return gaussians_of(
        means=pick("x", "y", "z"),
        quats=numbered("rot", 4),
        scales=torch.nn.functional.pad(scales, (0, 3 - scales.shape[1])).numpy(),
        opacities=torch.sigmoid(torch.from_numpy(pick("opacity")[:, 0])).numpy(),
        sh=from_rest(numbered("f_dc", 3), higher),
    )


def _read_vertices(path: Path) -> np.ndarray:
    """Read the element "vertex" of a .ply as a structured array, a field per property."""
    data = read_bytes(path, "a .ply of Gaussians")
    end = re.search(rb"\nend_header[ \t]*\r?\n", data)
    if not re.match(rb"ply[ \t]*\r?\n", data) or end is None:
        raise InputError(f"{path}: {known_container(path) or 'not a .ply file'}")
    lines = data[: end.start()].decode("ascii", errors="replace").splitlines()[1:]
    lines = [line.split() for line in lines if not line.startswith(("comment", "obj_info"))]
    if not lines or " ".join(lines[0]) != f"format {_FORMAT}":
        raise InputError(f"{path}: expected the format {_FORMAT}, as 3DGS writes it")
    element, fields = lines[1] if len(lines) > 1 else [], []
    if element[:2] != ["element", "vertex"] or not element[-1].isdecimal():
        raise InputError(f"{path}: element 'vertex' is missing or not the first one")
    for line in lines[2:]:
        if line[:1] == ["element"]:
            break
        if len(line) != 3 or line[0] != "property" or line[1] not in TYPES:
            wrong = f"'{' '.join(line)}'; expected a number's property, with its type"
            raise InputError(f"{path}: the header says {wrong}")
        if line[2] in dict(fields):
            raise InputError(f"{path}: the property '{line[2]}' is named twice")
        fields.append((line[2], TYPES[line[1]]))
    row, count = np.dtype(fields), int(element[-1])
    if count * row.itemsize > len(data) - end.end():
        raise InputError(f"{path}: cut short, {count} rows of 'vertex' were announced")
    if not count or not fields:
        return np.empty(count if fields else 0, row)
    return np.frombuffer(data, row, count, end.end())


def _properties(coefficients: int) -> list[str]:
    """Names of a file's columns, for colours with ``coefficients`` SH coefficients each."""
    colors = [f"f_dc_{i}" for i in range(3)] + [f"f_rest_{i}" for i in range(3 * coefficients - 3)]
    return ["x", "y", "z", "nx", "ny", "nz", *colors, *_GEOMETRY]
