"""Old name of a part of :mod:`gva_mi.options`; goes with the move to ``gva_mi.core``."""

from gva_mi.options import (
    InnerShare,
    Metres,
    PictureSide,
    Rate,
    Seed,
    Share,
    Turn,
    Weight,
    Within,
    Workers,
    ranges,
    require_ranges,
)

__all__ = [
    "InnerShare", "Metres", "PictureSide", "Rate", "Seed", "Share", "Turn", "Weight", "Within",
    "Workers", "ranges", "require_ranges",
]  # fmt: skip
