"""3D Gaussian splatting on Dr.Jit's LLVM backend: forward, adjoint and tangent, float32 and 64.

Usable alone:

* ``render(gaussians, camera)`` makes a picture of torch tensors, differentiable; for Dr.Jit tensors
  it is :func:`gva_mi.splat.drjit_op.render`.
* ``rasterization(...)`` is the same with gsplat's signature. Beside it stand gsplat's
  ``fully_fused_projection``, ``isect_tiles``, ``isect_offset_encode``, ``rasterize_to_pixels``,
  ``spherical_harmonics``, ``quat_scale_to_covar_preci`` and ``compute_relocation``.

Read kernels/ in this order: lens.py (where a point falls in the picture), ellipse.py (a Gaussian's
shape there), sh.py (its colour), project.py (all three, for all Gaussians), tiles.py (who touches
which tile), pixel.py (one pixel meets one Gaussian), blend.py (the loops around it), passes.py (one
after the other).

The checks stand apart: reference.py is the slow twin, gradcheck/ compares the kernels with it and
with other answers, bench/ times them, and scene.py holds the scenes for both.

Importing this folder imports Dr.Jit and numpy; torch comes with the first use of ``render``,
``Screen`` or one of gsplat's functions.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from gva_mi import llvm
from gva_mi.splat.camera import Camera, look_at
from gva_mi.splat.gaussians import Gaussians, Image
from gva_mi.splat.kernels.exclusive import exclusive
from gva_mi.splat.options import SplatOptions

if TYPE_CHECKING:
    from gva_mi.splat.gsplat_compat import rasterization
    from gva_mi.splat.gsplat_functions import (
        compute_relocation,
        isect_offset_encode,
        isect_tiles,
        quat_scale_to_covar_preci,
        spherical_harmonics,
    )
    from gva_mi.splat.gsplat_pixels import rasterize_to_pixels
    from gva_mi.splat.gsplat_projection import fully_fused_projection
    from gva_mi.splat.screen import Screen
    from gva_mi.splat.torch_op import render

llvm.require()

__all__ = [
    "Camera",
    "Gaussians",
    "Image",
    "Screen",
    "SplatOptions",
    "compute_relocation",
    "exclusive",
    "fully_fused_projection",
    "isect_offset_encode",
    "isect_tiles",
    "look_at",
    "quat_scale_to_covar_preci",
    "rasterization",
    "rasterize_to_pixels",
    "render",
    "spherical_harmonics",
]

_NEED_TORCH = {  # names, and the files they are in
    "Screen": "screen",
    "compute_relocation": "gsplat_functions",
    "fully_fused_projection": "gsplat_projection",
    "isect_offset_encode": "gsplat_functions",
    "isect_tiles": "gsplat_functions",
    "quat_scale_to_covar_preci": "gsplat_functions",
    "rasterization": "gsplat_compat",
    "rasterize_to_pixels": "gsplat_pixels",
    "render": "torch_op",
    "spherical_harmonics": "gsplat_functions",
}


def __getattr__(name: str) -> Any:  # noqa: ANN401
    """The names that need torch, which is imported with the first of them."""
    if name in _NEED_TORCH:
        return getattr(import_module(f"gva_mi.splat.{_NEED_TORCH[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
