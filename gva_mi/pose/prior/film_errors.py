"""How the film solver errs: an error model that is known before any video.

A constant error does not show in a track, and a smooth one looks like motion: how large they are is
knowledge about the estimator, and not about this video. The table is what
``python -m gva_mi.study.film_errors`` prints, of the solver of :mod:`gva_mi.pose.film` on rendered
films with ground truth, in the form of :mod:`gva_mi.pose.prior.error_model`. Fingers are left out:
they err by 17°, but images of this size cannot bend them better, and their errors are inferred.
"""

from __future__ import annotations

import numpy as np

from gva_mi.pose.prior.error_model import Stage1ErrorModel

FPS = 30.0  # frames a second of a film that does not say it

# Standard deviations of the slow part and of the constant one; seconds that the slow one lasts; and
# the seconds of lag: what the slow one grows by, relative to the speed.
_DEGREES = {
    "pelvis": (2.2, 0.0, 0.2, 0.050),
    "spine": (1.3, 0.0, 0.2, 0.081),
    "head": (3.2, 0.0, 0.2, 0.092),
    "shoulders": (6.6, 0.0, 0.2, 0.093),
    "elbows": (3.2, 0.0, 0.2, 0.151),
    "wrists": (3.1, 0.0, 0.2, 0.134),
    "hips": (4.3, 0.0, 0.2, 0.094),
    "knees": (4.2, 0.0, 0.2, 0.122),
    "feet": (1.6, 0.0, 0.2, 0.232),
}
_METRES = {"aside": (0.026, 0.008, 0.4, 0.0), "depth": (0.065, 0.028, 0.4, 0.0)}


def film_errors(fps: float) -> dict[str, Stage1ErrorModel]:
    """Return the error models of a film of so many frames a second, by group of joints."""
    rows = {name: (*np.radians(row[:2]).tolist(), *row[2:]) for name, row in _DEGREES.items()}
    return {
        name: Stage1ErrorModel(0.0, slow, memory * fps, bias, lag * fps)
        for name, (slow, bias, memory, lag) in (rows | _METRES).items()
    }
