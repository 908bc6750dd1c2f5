"""A scene small enough to measure in no time."""

import numpy as np
import pytest

from gva_mi.splat.bench.timing import Work
from gva_mi.splat.scene import person_scene


@pytest.fixture(scope="package")
def work():
    return Work.on(person_scene(np.random.default_rng(0), 300, 64))
