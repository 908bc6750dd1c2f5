"""The axes of Gaussians in files, and half a turn between them and this program's world.

==========================================  =====================  ==================
Where                                       y                      z
==========================================  =====================  ==================
the world here, SMPL-X, .glb, .spz          up                     toward the viewer
.ply of 3DGS, compressed .ply, .splat       down                   away from it
==========================================  =====================  ==================

x is to the viewer's right in both, so half a turn about x leads from one to the other and back. It
only changes signs: those of y and z, and of the basis functions of colour that are odd in them.
"""

from __future__ import annotations

from dataclasses import replace

from gva_mi.splat.gaussians import MAX_DEGREE, Gaussians
from gva_mi.splat.kernels.sh import basis

_HERE, _THERE = ((0.3, y, z) for y, z in ((0.5, 0.7), (-0.5, -0.7)))  # any direction, and turned
_SIGNS = [
    1.0 if a * b > 0 else -1.0
    for a, b in zip(basis(MAX_DEGREE, *_HERE), basis(MAX_DEGREE, *_THERE), strict=True)
]  # of the coefficients of spherical harmonics


def half_turned(gaussians: Gaussians) -> Gaussians:
    """Turn Gaussians (torch tensors) half a turn about x, without rounding; its own inverse."""
    turned = {
        "means": (1.0, -1.0, -1.0),
        "quats": (1.0, 1.0, -1.0, -1.0),
        "covars": (1.0, -1.0, -1.0, 1.0, 1.0, 1.0),
    }
    arrays = gaussians.arrays()
    changed = {k: x * x.new_tensor(turned[k]) for k, x in arrays.items() if k in turned}
    if gaussians.sh is not None:
        sh = gaussians.sh
        changed["sh"] = sh * sh.new_tensor(_SIGNS[: sh.shape[1]])[:, None]
    return replace(gaussians, **changed)
