"""Stage 2: poses refined until they agree with masks and normals (Eq. 8).

:func:`refine` takes a video, a body and one of two options types, which also chooses the method:
:class:`SequenceOptions` refines all frames together, :class:`SingleFrameOptions` minimises Eq. 8 as
printed, frame by frame.

Both minimise evidence + prior, and each side has one interface:

* **Evidence** compares poses with what was observed. It implements
  :class:`gva_mi.pose.optimize.Evidence`: ``loss(frames, pose)`` for the poses, and ``energy()`` for
  the unknowns that all frames share (clothes, shape, focal length). Implementations:
  ``ClothedPerson`` (``sequence.py``: masks, normals, close-ups and landmarks) and
  ``gva_mi.fit.photometric``. A further kind of evidence is one more term of
  ``ClothedPerson.loss``, or a class of its own.
* **Prior terms** say how probable poses are without any image, in nats. They implement
  :class:`gva_mi.pose.prior.inference.PriorTerm`: ``energy(rotations, transl, times)``.
  Implementations: ``anatomy.py``, ``ground.py`` and ``inference.py`` of ``prior/``. Stage 1 and
  inertia are a Gaussian process over the corrections instead (``process.py``): its errors are
  modelled in ``error_model.py``, its motion in ``process.py``, and ``inference.py`` estimates both
  from the video itself. How the solver of ``film/`` errs is known before (``film_errors``).

``corrections.py`` holds the unknowns, and ``optimize.py`` optimises them.
"""

from gva_mi.pose.refine import refine
from gva_mi.pose.sequence import SequenceOptions
from gva_mi.pose.single_frame import SingleFrameOptions

__all__ = ["SequenceOptions", "SingleFrameOptions", "refine"]
