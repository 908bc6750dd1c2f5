"""3D Gaussian splatting on Dr.Jit's LLVM backend: forward, adjoint and tangent, float32 and 64.

Usable alone:

* ``render(gaussians, camera)`` makes a picture of torch tensors, differentiable; for Dr.Jit tensors
  it is :func:`gva_mi.splat.drjit_op.render`.
* ``rasterization(...)`` is the same with gsplat's signature.

Read kernels/ in this order: lens.py (where a point falls in the picture), ellipse.py (a Gaussian's
shape there), sh.py (its colour), project.py (all three, for all Gaussians), tiles.py (who touches
which tile), pixel.py (one pixel meets one Gaussian), blend.py (the loops around it), passes.py (one
after the other).

The checks stand apart: reference.py is the slow twin, gradcheck/ compares the kernels with it and
with other answers, bench/ times them, and scene.py holds the scenes for both.

Importing this folder imports Dr.Jit and numpy; torch comes with the first use of ``render``,
``Screen`` or ``rasterization``.
"""

from typing import TYPE_CHECKING, Any

from gva_mi import llvm
from gva_mi.splat.camera import Camera, look_at
from gva_mi.splat.gaussians import Gaussians, Image
from gva_mi.splat.kernels.exclusive import exclusive
from gva_mi.splat.options import SplatOptions

if TYPE_CHECKING:
    from gva_mi.splat.gsplat_compat import rasterization
    from gva_mi.splat.screen import Screen
    from gva_mi.splat.torch_op import render

llvm.require()

__all__ = [
    "Camera",
    "Gaussians",
    "Image",
    "Screen",
    "SplatOptions",
    "exclusive",
    "look_at",
    "rasterization",
    "render",
]


def __getattr__(name: str) -> Any:  # noqa: ANN401
    """The names that need torch, which is imported with the first of them."""
    if name == "render":
        from gva_mi.splat.torch_op import render

        return render
    if name == "Screen":
        from gva_mi.splat.screen import Screen

        return Screen
    if name == "rasterization":
        from gva_mi.splat.gsplat_compat import rasterization

        return rasterization
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
