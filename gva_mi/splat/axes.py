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

_SOMEWHERE = (0.3, 0.5, 0.7)  # any direction in which no basis function is zero


def half_turned(gaussians: Gaussians) -> Gaussians:
    """Turn Gaussians (torch tensors) half a turn about x, without rounding; its own inverse."""
    return with_signs(gaussians, (1, -1, -1))


def with_signs(gaussians: Gaussians, signs: tuple[int, int, int]) -> Gaussians:
    """Change the signs of the axes x, y, z of Gaussians (torch tensors), without rounding.

    An odd number of changes mirrors the scene; each ellipsoid is its own mirror image in the planes
    of its axes, so that it keeps a rotation.
    """
    x, y, z = (float(sign) for sign in signs)
    there = tuple(sign * c for sign, c in zip(signs, _SOMEWHERE, strict=True))
    pairs = zip(basis(MAX_DEGREE, *_SOMEWHERE), basis(MAX_DEGREE, *there), strict=True)
    of_colors = [1.0 if a * b > 0 else -1.0 for a, b in pairs]
    turned = {
        "means": (x, y, z),
        "quats": (1.0, y * z, x * z, x * y),
        "covars": (1.0, x * y, x * z, 1.0, y * z, 1.0),
    }
    arrays = gaussians.arrays()
    changed = {k: x * x.new_tensor(turned[k]) for k, x in arrays.items() if k in turned}
    if gaussians.sh is not None:
        sh = gaussians.sh
        changed["sh"] = sh * sh.new_tensor(of_colors[: sh.shape[1]])[:, None]
    return replace(gaussians, **changed)
