"""Stage 2: poses made to agree with the pictures (Eq. 9)."""

from gva_mi.pose.refine import Refined, RefineOptions, refine

__all__ = ["RefineOptions", "Refined", "refine"]
