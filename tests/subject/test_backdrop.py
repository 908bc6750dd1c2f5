"""The person is separated from any background without its colours."""

import numpy as np
import pytest

from gva_mi.subject.backdrop import premultiplied

H, W = 24, 32


@pytest.fixture
def person():
    """Colours (H, W, 3) in [0, 1], and how much of each pixel is theirs (H, W): a soft disk."""
    random = np.random.default_rng(0)
    y, x = np.mgrid[:H, :W]
    mask = (6.5 - np.hypot(y - 11.3, x - 15.8)).clip(0, 1).astype(np.float32)
    return random.uniform(0, 1, (H, W, 3)).astype(np.float32), mask


@pytest.mark.parametrize("backdrop", [0.0, 1.0, np.float32([0.2, 0.9, 0.4])])
def test_a_plain_background_leaves_no_trace_in_the_person(person, backdrop):
    F, S = person[0], person[1][..., None]
    assert ((S > 0.05) & (S < 0.95)).sum() > 20
    np.testing.assert_allclose(
        premultiplied(S * F + (1 - S) * backdrop, S[..., 0]), S * F, atol=1e-6
    )


def test_most_of_a_coloured_background_is_removed(person):
    F, S = person[0], person[1][..., None]
    x = np.linspace(0, 1, W, dtype=np.float32)[None, :, None]
    wall = np.broadcast_to(np.concatenate([x, 1 - x, 0.5 + 0 * x], -1), F.shape)
    image = S * F + (1 - S) * wall
    left = [np.abs(found - S * F).max() for found in (premultiplied(image, S[..., 0]), S * image)]
    assert left[0] < 0.4 * left[1]


def test_hard_everywhere_and_empty_masks(person):
    hard = (person[1] > 0.5).astype(np.float32)
    assert np.array_equal(premultiplied(person[0], hard), person[0] * hard[..., None])
    np.testing.assert_allclose(premultiplied(person[0], 0 * hard + 0.5), 0.5 * person[0])
    assert not premultiplied(person[0], 0 * hard).any()
