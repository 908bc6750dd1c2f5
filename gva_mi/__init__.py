"""gva_mi: a monocular video of a person becomes a drivable 3D Gaussian avatar, on a CPU.

An implementation of *GVA: Reconstructing Vivid 3D Gaussian Avatars from Monocular Videos* on
Dr.Jit and Mitsuba 3. The packages follow the paper: ``splat`` (Eq. 1-3), ``body`` (Eq. 4-6),
``avatar`` (what is learned, Sec. 4), ``refine`` (Eq. 8) and ``fit`` (Eq. 9). ``subject`` reads and
writes the folder of a video, ``mesh`` renders a body for ``refine`` through Mitsuba, ``synthetic``
makes subjects, ``study`` measures, ``app`` has all steps as functions, and ``cli`` is the command
line. Equation numbers are the printed paper's.

Importing it imports nothing heavy: it only chooses the libLLVM that Dr.Jit is going to load.
"""

from gva_mi.core.errors import InputError
from gva_mi.core.llvm import prepare as _prepare_llvm

__version__ = "0.1.0"
__all__ = ["InputError", "__version__"]

_prepare_llvm()
