"""gva_mi: a monocular video of a person becomes a drivable 3D Gaussian avatar, on a CPU.

An implementation of *GVA: Reconstructing Vivid 3D Gaussian Avatars from Monocular Videos* on
Dr.Jit and Mitsuba 3. Equation numbers are the printed paper's. From the bottom up:

==============  ====================================================================
``core``        errors, files, options, result stamps, workers, libLLVM
``jit``         between Dr.Jit and torch: the lock, frozen kernels, memory
``splat``       Gaussian splatting (Eq. 1-3), usable alone
``body``        SMPL-X, skinning (Eq. 4-6), the built-in body
``mesh``        a mesh rendered by Mitsuba, as a torch function
``subject``     the folder of a person's video: read, write, check
``networks``    landmarks and masks from pictures
``matting``     masks that follow the person's outline
``readers``     files of other programs: estimators, data sets, motions
``synthetic``   synthetic subjects with ground truth
``prior``       pose prior of both stages
``observe``     landmarks as evidence, for both stages
``stage1``      stage 1: poses of a video, from landmarks
``refine``      stage 2: refined poses (Eq. 8)
``avatar``      Gaussians on a skeleton: the trained model (Sec. 4)
``fit``         training (Eq. 9) and tracking
``gradcheck``   gradients compared with references
``evaluate``    metrics and reports of a run
``study``       studies over many subjects
``app``         all steps as functions
``viewer``      the viewer in the browser
``cli``         the command line
==============  ====================================================================

Importing ``gva_mi`` imports nothing heavy: it only chooses the libLLVM that Dr.Jit will load.
"""

from gva_mi.core.errors import InputError
from gva_mi.core.llvm import prepare as _prepare_llvm

__version__ = "0.1.0"
__all__ = ["InputError", "__version__"]

_prepare_llvm()
