"""A motion that is known: somebody who walks, in a world with y up."""

import numpy as np
import pytest


@pytest.fixture(scope="session")
def walk():
    """Rotations (T, 55, 3) and translations (T, 3) of so many frames."""

    def motion(frames):
        random = np.random.default_rng(1)
        t = np.arange(frames)[:, None, None] / 30
        rotations = 0.3 * np.sin(2 * t + 6 * random.random((1, 55, 1))) * random.random((1, 55, 3))
        rotations[:, 0] = 0
        rotations[:, 0, 1] = 0.4 * t[:, 0, 0]
        transl = np.concatenate([t[:, 0] * 0.5, 0 * t[:, 0], t[:, 0] * 0.2], axis=1)
        return rotations, transl

    return motion
