"""3D Gaussian splatting on Dr.Jit's LLVM backend: forward, adjoint, tangent; float32 and float64.

Usable alone. Read the kernels in this order: lens.py (where a point falls in the picture),
ellipse.py (a Gaussian's shape there), project.py (both, for all Gaussians), tiles.py (who touches
which tile), pixels.py and blend.py (compositing), pipeline.py (one after the other; chunks.py for
wide colours, frozen.py so that each is traced once).

``render`` comes twice: :mod:`gva_mi.splat.drjit_op` for Dr.Jit arrays, :mod:`gva_mi.splat.torch_op`
for torch tensors. :mod:`gva_mi.splat.gsplat_compat` has gsplat's signature.

The proofs stand apart: reference.py is the slow twin, gradcheck/ compares the kernels with it and
with other answers, bench/ times them, and scene.py makes what they are tried on.

Importing this folder imports Dr.Jit and numpy; torch comes with the modules that name it.
"""

from gva_mi import llvm
from gva_mi.splat.camera import Camera, look_at
from gva_mi.splat.gaussians import Gaussians, Image
from gva_mi.splat.options import SplatOptions

llvm.require()

__all__ = ["Camera", "Gaussians", "Image", "SplatOptions", "look_at"]
