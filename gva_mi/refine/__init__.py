"""Stage 2: poses refined until they agree with masks and normals (Eq. 8).

:func:`refine` takes a video, a body and one of two options types, which also chooses the method:
:class:`SequenceOptions` refines all frames together, :class:`SingleFrameOptions` minimises Eq. 8 as
printed, frame by frame.

Both minimise evidence + prior, and each side has one interface:

* **Evidence** compares poses with what was observed. It implements
  :class:`gva_mi.refine.optimize.Evidence`: ``loss(frames, pose)`` for the poses, and ``energy()``
  for the unknowns that all frames share (clothes, shape, focal length). Implementations:
  ``ClothedPerson`` (``sequence.py``: masks, normals, close-ups and landmarks) and
  ``gva_mi.fit.photometric``. A further kind of evidence is one more term of
  ``ClothedPerson.loss``, or a class of its own.
* **Prior terms** say how probable poses are without any image, in nats (:mod:`gva_mi.prior`):
  ``energy(rotations, transl, times)``. Stage 1 and inertia are a Gaussian process over the
  corrections instead.

``corrections.py`` holds the unknowns, and ``optimize.py`` optimises them.
"""

from gva_mi.refine.refine import refine
from gva_mi.refine.sequence import SequenceOptions
from gva_mi.refine.single_frame import SingleFrameOptions

__all__ = ["SequenceOptions", "SingleFrameOptions", "refine"]
