"""How many frames a second a motion has, by the names under which programs say so."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from gva_mi.core.errors import InputError
from gva_mi.core.options import Within
from gva_mi.data.importers.spellings import plain_name

RATES = ("mocap_framerate", "mocap_frame_rate", "fps", "framerate", "frame_rate")
AIST_RATE = 60.0  # frames a second of AIST++, whose files do not say so
FPS = Within(0.001, 10_000)  # frames a second


def rate_of(where: str, found: Mapping[str, Any], given: float | None) -> float:
    """Return a motion's frames per second: the ``given`` ones, or what its arrays say.

    120.00004 becomes 120.
    """
    if given is not None:
        return given
    found = {plain_name(name): x for name, x in found.items()}
    name = next((name for name in RATES if name in found), None)
    if name is None and "scaling" in found:
        return AIST_RATE
    if name is None:
        raise InputError(
            f"{where}: says no frame rate (none of {', '.join(RATES)}); give --source-fps of "
            "gva-mi motion"
        )
    try:
        rate = float(np.ravel(found[name])[0])
    except (ValueError, TypeError, IndexError):
        rate = np.nan
    if rate not in FPS:
        raise InputError(f"{where}: '{name}' must be frames a second, got {found[name]!s:.40}")
    return float(round(rate)) if abs(rate - round(rate)) < 1e-3 * rate and rate > 1 else rate
