"""Stage 2: poses refined until they agree with masks and normals (Eq. 8).

:func:`refine` takes a video, a body and one of two options types, which also chooses the method:
:class:`SequenceOptions` refines all frames together, :class:`SingleFrameOptions` minimises Eq. 8 as
printed, frame by frame.

========================  ============================================================
``refine``                videos in, refined poses out; clips as jobs: start here
``observed_video``        the evidence of a video, gathered before its refinement
``sequence``              the method for all frames together, with the clothes' displacement
``single_frame``          the method of Eq. 8 as printed
``optimize``              minimises evidence + prior
``corrections``           the unknowns: corrections of stage 1, and their prior energy
``vector_adam``           the optimiser, and the learning rates of joints
``image_evidence``        masks and normals: the data term of Eq. 8
``close_ups``             the same of hands and feet, at the video's own resolution
``landmark_evidence``     landmarks
``uncertainty``           covariances of the poses found: what one camera can see
``frame_losses``          losses of frames, shared among processes
``clips``                 cuts a long video into clips, and joins the results
========================  ============================================================

Evidence and prior have one interface each:

* **Evidence** compares poses with what was observed. It implements
  :class:`gva_mi.refine.optimize.Evidence`: ``loss(frames, pose)`` for the poses, and ``energy()``
  for the unknowns that all frames share (clothes, shape, focal length). Implementations:
  ``ClothedPerson`` (``sequence.py``: masks, normals, close-ups and landmarks) and
  ``gva_mi.fit.photometric``. A further kind of evidence is one more term of
  ``ClothedPerson.loss``, or a class of its own.
* **Prior terms** say how probable poses are without any image, in nats (:mod:`gva_mi.prior`):
  ``energy(rotations, transl, times)``. Stage 1 and inertia are a Gaussian process over the
  corrections instead.
"""

from gva_mi.refine.observed_video import RefineOptions
from gva_mi.refine.refine import refine
from gva_mi.refine.sequence import SequenceOptions
from gva_mi.refine.single_frame import SingleFrameOptions

__all__ = ["RefineOptions", "SequenceOptions", "SingleFrameOptions", "refine"]
