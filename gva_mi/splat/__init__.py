"""3D Gaussian splatting on Dr.Jit's LLVM backend: forward and adjoint kernels, in float32 and float64; usable alone.

* :mod:`gva_mi.splat.render` takes Dr.Jit arrays, :mod:`gva_mi.splat.torch_op` torch tensors; both have ``render``.
* project.py (the ellipse in the picture), tiles.py (who touches which tile) and blend.py (compositing) are the kernels:
  read them in this order.
* reference.py is the slow twin, gradcheck.py compares the two.

Importing this folder imports Dr.Jit and numpy at most; torch only with the modules that name it.
"""

from gva_mi.splat.camera import Camera, look_at
from gva_mi.splat.gaussians import Gaussians, Image
from gva_mi.splat.options import SplatOptions

__all__ = ["Camera", "Gaussians", "Image", "SplatOptions", "look_at"]
