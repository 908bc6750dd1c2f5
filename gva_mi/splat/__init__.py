"""3D Gaussian splatting on Dr.Jit, usable alone."""

from gva_mi import llvm
from gva_mi.splat.camera import Camera, look_at
from gva_mi.splat.gaussians import Gaussians, Image
from gva_mi.splat.options import SplatOptions

__all__ = ["Camera", "Gaussians", "Image", "SplatOptions", "look_at"]

llvm.require()
