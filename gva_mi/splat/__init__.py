"""3D Gaussian splatting on Dr.Jit's LLVM backend: forward, adjoint and tangent, float32 and 64.

Usable alone: ``render(gaussians, camera)`` draws torch tensors, differentiably.

==================  ================================================================
``camera``          the camera, and all conventions about axes and pixels
``gaussians``       ``Gaussians``, the input, and ``Image``, the output
``options``         cut-offs, for the kernels and the reference implementation
``torch_render``    ``render`` on torch tensors, in autograd and torch.func
``torch_passes``    forward, adjoint and tangent on torch tensors; ``Screen``
``drjit_render``    ``render`` on Dr.Jit tensors
``gsplat``          ``rasterization``, with gsplat's signature and its ``meta``
``kernels``         the kernels, in the order in which to read them
``reference``       the reference implementation, in float64 torch
``scene``           scenes to test and to measure with
``axes``            half a turn between files and the world; axes of a covariance
``formats``         .ply, .spz and .splat
==================  ================================================================

:mod:`gva_mi.gradcheck` compares the kernels with the reference implementation and other methods.

Importing this package imports Dr.Jit and numpy; torch is imported with the first use of ``render``,
``rasterization`` or ``Screen``.
"""

from importlib import import_module
from typing import TYPE_CHECKING

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


if not TYPE_CHECKING:  # which would take any name for one of the package

    def __getattr__(name: str) -> object:
        """Import a name that needs torch at its first use."""
        if name in _NEED_TORCH:
            return getattr(import_module(f"gva_mi.splat.{_NEED_TORCH[name]}"), name)
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
