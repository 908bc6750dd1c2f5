"""Old name of a part of :mod:`gva_mi.arrays`; goes with the move to ``gva_mi.core``."""

from gva_mi.arrays import LARGEST, Budget, Damaged, Refused

__all__ = ["LARGEST", "Budget", "Damaged", "Refused"]
