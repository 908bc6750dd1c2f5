"""Old name of a part of :mod:`gva_mi.options`; goes with the move to ``gva_mi.core``."""

from gva_mi.options import from_json

__all__ = ["from_json"]
