"""Pictures made smaller."""

import numpy as np
import pytest

from gva_mi.subject.crop import block_means


@pytest.mark.parametrize("shape", [(13, 21), (13, 21, 3)])
@pytest.mark.parametrize("side", [1, 2, 5])
def test_a_smaller_picture_has_the_means_of_whole_blocks(shape, side):
    image = np.random.default_rng(0).random(shape, dtype=np.float32)
    h, w = 13 // side, 21 // side
    found = block_means(image, side)
    assert found.shape == (h, w, *shape[2:]) and found.dtype == np.float32
    for i, j in np.ndindex(h, w):
        block = image[i * side : (i + 1) * side, j * side : (j + 1) * side]
        np.testing.assert_allclose(found[i, j], block.mean((0, 1)), rtol=1e-6)
