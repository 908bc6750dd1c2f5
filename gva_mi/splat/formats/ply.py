"""The .ply of 3D Gaussian Splatting: reader and writer.

One binary little-endian vertex per Gaussian, all float32, in the order of the original code:

    x y z · nx ny nz · f_dc_0..2 · f_rest_0.. · opacity · scale_0..2 · rot_0..3

* normals are zero, ``opacity`` is a logit, ``scale`` a logarithm, ``rot`` a quaternion wxyz;
* f_rest goes channel by channel: all red coefficients, then green, then blue.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch

from gva_mi.core.atomic import atomic_write
from gva_mi.core.errors import InputError
from gva_mi.splat.formats.compressed_ply import decompressed, is_compressed
from gva_mi.splat.formats.ply_elements import read_elements
from gva_mi.splat.gaussians import Gaussians, degree_of
from gva_mi.splat.geometry import with_axes
from gva_mi.splat.kernels.sh import C0

_GEOMETRY = ["opacity", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
_MARGIN = 1e-7  # distance of opacities to 0 and 1, whose logits are infinite


def save_ply(path: Path, gaussians: Gaussians) -> None:
    """Write Gaussians in the format of 3DGS.

    Args:
        path: of the .ply; an older one is replaced once the new one is whole.
        gaussians: torch tensors; plain colours become the constant band of spherical harmonics.
    """
    path = Path(path)
    gaussians = with_axes(gaussians)
    array = lambda tensor: tensor.detach().double().numpy()
    sh = harmonics_of(gaussians)
    means, opacities = array(gaussians.means), array(gaussians.opacities)
    eta = np.clip(opacities, _MARGIN, 1 - _MARGIN)
    table = np.column_stack(
        [
            means,
            np.zeros_like(means),
            sh[:, 0],
            sh[:, 1:].transpose(0, 2, 1).reshape(len(means), 3 * (sh.shape[1] - 1)),
            np.log(eta / (1 - eta)),
            np.log(np.maximum(array(gaussians.scales), 1e-12)),
            array(gaussians.quats),
        ]
    )
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(means)}",
        *(f"property float {name}" for name in _properties(sh.shape[1])),
        "end_header\n",
    ]
    content = "\n".join(header).encode("ascii") + table.astype("<f4").tobytes()
    with atomic_write(path) as unfinished:
        unfinished.write_bytes(content)


def harmonics_of(gaussians: Gaussians) -> np.ndarray:
    """Return the colours' coefficients (N, K, 3); plain colours become the constant band."""
    if gaussians.sh is None:
        return ((gaussians.colors.detach().double().numpy() - 0.5) / C0)[:, None]
    return gaussians.sh.detach().double().numpy()


def load_ply(path: Path) -> Gaussians:
    """Read a .ply of 3DGS, or a compressed one of SuperSplat.

    Properties may come in any order; unknown properties and elements are ignored.

    Raises:
        InputError: not a binary .ply of Gaussians, truncated, or a property is missing.
    """
    path = Path(path)
    elements = read_elements(path)
    if "vertex" not in elements:
        raise InputError(f"{path}: element 'vertex' is missing; expected Gaussians as 3DGS writes")
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
    for name in _properties(1 + rest // 3):
        if name not in names and name not in ("nx", "ny", "nz"):
            raise InputError(f"{path}: property '{name}' is missing; expected Gaussians")
    pick = lambda *wanted: torch.from_numpy(
        np.stack([table[name] for name in wanted], axis=1).astype(np.float32)
    )
    numbered = lambda name, n: pick(*(f"{name}_{i}" for i in range(n)))
    count, sh = len(table), numbered("f_dc", 3)[:, None]
    if rest:
        higher = numbered("f_rest", rest).reshape(count, 3, rest // 3).transpose(1, 2)
        sh = torch.cat([sh, higher], dim=1)
    return Gaussians(
        means=pick("x", "y", "z"),
        quats=numbered("rot", 4),
        scales=torch.exp(numbered("scale", 3)),
        opacities=torch.sigmoid(pick("opacity")[:, 0]),
        sh=sh,
    )


def _properties(coefficients: int) -> list[str]:
    """Columns of a file whose colours have so many SH coefficients."""
    rest = [f"f_rest_{i}" for i in range(3 * (coefficients - 1))]
    return ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", *rest, *_GEOMETRY]
