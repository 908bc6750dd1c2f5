"""Stage 2: poses made to agree with the pictures (Eq. 8).

:func:`refine` takes a video, a body and one of two options types, which also chooses the way:
:class:`SequenceOptions` refines all frames together, :class:`SingleFrameOptions` minimises Eq. 8 as
printed, frame by frame.
"""

from gva_mi.pose.refine import Refined, refine
from gva_mi.pose.sequence import SequenceOptions
from gva_mi.pose.single_frame import SingleFrameOptions

__all__ = ["Refined", "SequenceOptions", "SingleFrameOptions", "refine"]
