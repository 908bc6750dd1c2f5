"""Structural similarity is scikit-image's, and its gradient exact."""

import numpy as np
import pytest
import torch
from skimage.metrics import structural_similarity

from gva_mi.fit.losses import ssim


def pictures(height, width, dtype=torch.float64):
    generator = torch.Generator().manual_seed(0)
    a = torch.rand(height, width, 3, generator=generator, dtype=dtype)
    noise = torch.randn(height, width, 3, generator=generator, dtype=dtype)
    return a, (a + 0.2 * noise).clamp(0, 1)


@pytest.mark.parametrize("shape", [(11, 11), (16, 20), (33, 12)])
def test_it_is_scikit_images(shape):
    a, b = pictures(*shape)
    _, full = structural_similarity(a.numpy(), b.numpy(), channel_axis=-1, data_range=1.0,
        gaussian_weights=True, sigma=1.5, use_sample_covariance=False, full=True)  # fmt: skip
    inside = full[5:-5, 5:-5]
    np.testing.assert_allclose(float(ssim(a, b)), inside.mean(), rtol=1e-9)


@pytest.mark.parametrize("shape", [(11, 11), (14, 13)])
def test_gradients_and_tangents_by_differences(shape):
    a, b = pictures(*shape)
    assert torch.autograd.gradcheck(lambda a: ssim(a, b), [a.requires_grad_()],
                                    check_forward_ad=True, fast_mode=True)  # fmt: skip


def test_an_image_smaller_than_the_window_is_refused():
    with pytest.raises(ValueError, match="at least 11 x 11"):
        ssim(*pictures(10, 20))
