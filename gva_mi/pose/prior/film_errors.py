"""How the film solver errs: an error model that is known before any video.

A constant error does not show in a track, and a smooth one looks like motion: how large they are is
knowledge about the estimator, and not about this video. The table is what
``python -m gva_mi.study.film_errors`` prints, of the solver of :mod:`gva_mi.pose.film` on rendered
films with ground truth, in the form of :mod:`gva_mi.pose.prior.error_model`. Fingers are left out:
they err by 17°, but images of this size cannot bend them better, and their errors are inferred.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from gva_mi.pose.prior.error_model import Stage1ErrorModel

FPS = 30.0  # frames a second of the films of the table

# Standard deviations of the slow part and of the constant one, and frames that the slow one lasts.
_DEGREES = {
    "pelvis": (4.0, 0.0, 6.0),
    "spine": (2.1, 0.9, 3.0),
    "head": (3.8, 1.5, 12.0),
    "shoulders": (8.1, 2.3, 6.0),
    "elbows": (8.4, 1.9, 6.0),
    "wrists": (6.1, 0.6, 6.0),
    "hips": (5.4, 2.3, 6.0),
    "knees": (4.0, 0.0, 12.0),
    "feet": (4.4, 1.8, 3.0),
}
_METRES = {"aside": (0.026, 0.008, 12.0), "depth": (0.065, 0.028, 12.0)}


def _model(slow: float, bias: float, memory: float) -> Stage1ErrorModel:
    return Stage1ErrorModel(white=0.0, slow=slow, memory=memory, bias=bias)


FILM_ERRORS: Mapping[str, Stage1ErrorModel] = MappingProxyType(
    {name: _model(*np.radians(row[:2]).tolist(), row[2]) for name, row in _DEGREES.items()}
    | {name: _model(*row) for name, row in _METRES.items()}
)


def errors_at(fps: float) -> dict[str, Stage1ErrorModel]:
    """Return the table for another frame rate: errors last as many seconds, not frames."""
    return {n: replace(e, memory=e.memory * fps / FPS) for n, e in FILM_ERRORS.items()}
