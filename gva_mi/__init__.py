"""gva_mi: a monocular video of a person becomes a drivable 3D Gaussian avatar, on a CPU.

An implementation of *GVA: Reconstructing Vivid 3D Gaussian Avatars from Monocular Videos* on
Dr.Jit and Mitsuba 3. The folders tell the paper: ``splat`` (Eq. 1-3), ``body`` (Eq. 4-6), ``pose``
(Eq. 8), ``avatar`` (what is learned, Sec. 4), ``fit`` (Eq. 9), ``data`` (where frames come from).
``mesh`` shows a body to ``pose`` through Mitsuba, ``synthetic`` makes subjects, ``study`` measures,
and ``cli`` is the command line. Equation numbers are the printed paper's.

Importing it imports nothing heavy: it only chooses the libLLVM that Dr.Jit is going to load.
"""

from gva_mi.core.errors import InputError
from gva_mi.core.llvm import prepare as _prepare_llvm

__version__ = "0.1.0"
__all__ = ["InputError", "__version__"]

_prepare_llvm()
