"""Find what is wrong with a subject's folder: ``gva-mi check``.

The other steps stop at the first thing that they cannot use, and believe numbers that have the
right shape. Here every file is read for itself, and what the numbers mean is checked against masks
and normal maps.
"""

from gva_mi.data.check.check import check_subject
from gva_mi.data.check.problems import CheckReport, Problem

__all__ = ["CheckReport", "Problem", "check_subject"]
