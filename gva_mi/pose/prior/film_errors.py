"""How the film solver errs: an error model that is known before any video.

A constant error does not show in a track, and a smooth one looks like motion: how large they are is
knowledge about the estimator, and not about this video. The solver errs more while a joint moves.
The rows of joints are what ``python -m gva_mi.study.film_errors`` prints, of the solver of
:mod:`gva_mi.pose.film` on nine rendered films with ground truth: five in rooms (turns, half a turn,
a walk, everyday motion; seeds 120, 123, 125, 130, 131) and four before a white wall (seeds 101,
103, 104, 106). All joints have one memory, for the refinement gets worse with the longer ones that
fit the errors of shoulders better. The rows of the position are wider than the errors that were
found; narrower ones hardly change the result. Fingers are left out: they err by 18°, but images of
this size cannot bend them better, and their errors are inferred.
"""

from __future__ import annotations

import numpy as np

from gva_mi.pose.prior.error_model import Stage1ErrorModel

FPS = 30.0  # frames a second of a film that does not say it

MEMORY = 0.2  # seconds that the slow errors of joints last
MEMORY_OF_PLACE = 0.4  # the same of the position

# Standard deviations of the slow part and of the constant one, and seconds of lag: what the slow
# one grows by, relative to the speed.
_DEGREES = {
    "pelvis": (1.0, 0.0, 0.054),
    "spine": (1.3, 0.3, 0.248),
    "head": (3.0, 1.4, 0.0),
    "shoulders": (5.3, 2.3, 0.094),
    "elbows": (5.6, 1.7, 0.115),
    "wrists": (4.1, 1.5, 0.122),
    "hips": (3.1, 1.0, 0.097),
    "knees": (1.4, 0.0, 0.187),
    "feet": (0.8, 0.0, 0.337),
}
_METRES = {"aside": (0.026, 0.008), "depth": (0.065, 0.028)}


def film_errors(fps: float) -> dict[str, Stage1ErrorModel]:
    """Return the error models of a film of so many frames a second, by group of joints."""
    rows = {name: (*np.radians(row[:2]).tolist(), row[2]) for name, row in _DEGREES.items()}
    joints = {
        name: Stage1ErrorModel(0.0, slow, MEMORY * fps, bias, lag * fps)
        for name, (slow, bias, lag) in rows.items()
    }
    return joints | {
        name: Stage1ErrorModel(0.0, slow, MEMORY_OF_PLACE * fps, bias)
        for name, (slow, bias) in _METRES.items()
    }
