"""3D Gaussian splatting on Dr.Jit's LLVM backend: forward, adjoint and tangent, float32 and 64.

Usable alone:

* ``render(gaussians, camera)`` draws torch tensors, differentiably; for Dr.Jit tensors use
  :func:`gva_mi.splat.drjit_render.render`.
* ``rasterization(...)`` has gsplat's signature, and its ``meta``.

Read kernels/ in this order: lens.py (where a point falls in the picture), ellipse.py (a Gaussian's
shape there), sh.py (its colour), project.py (all three, for all Gaussians), tiles.py (which
Gaussians touch which tile), pixel.py (one pixel meets one Gaussian), blend.py (the loops around
it), passes.py (forward, adjoint, tangent).

Checks: reference.py is the reference implementation, gradcheck/ compares the kernels with it and
with other methods, and scene.py holds the scenes.

Importing this package imports Dr.Jit and numpy; torch is imported with the first use of ``render``,
``rasterization`` or ``Screen``.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from gva_mi.core import llvm
from gva_mi.jit.frozen import exclusive
from gva_mi.splat.camera import Camera, look_at
from gva_mi.splat.gaussians import Gaussians, Image
from gva_mi.splat.options import SplatOptions

if TYPE_CHECKING:
    from gva_mi.splat.gsplat import rasterization
    from gva_mi.splat.torch_passes import Screen
    from gva_mi.splat.torch_render import render

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

_NEED_TORCH = {
    "Screen": "torch_passes",
    "rasterization": "gsplat",
    "render": "torch_render",
}  # their modules


def __getattr__(name: str) -> Any:  # noqa: ANN401
    """Import a name that needs torch at its first use."""
    if name in _NEED_TORCH:
        return getattr(import_module(f"gva_mi.splat.{_NEED_TORCH[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
