"""Find what is wrong with a subject's folder: ``gva-mi check``.

The other steps stop at the first file that they cannot use, and trust numbers of the right shape.
The check reads every file on its own, and tests the meaning of the numbers against masks and normal
maps.
"""

from gva_mi.data.check.check import check_subject

__all__ = ["check_subject"]
