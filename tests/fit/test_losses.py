"""The rendering loss: Eq. 9, its weights and its window."""

import numpy as np
import pytest
import torch

from gva_mi.fit.backgrounds import Cutout
from gva_mi.fit.losses import LossOptions, render_losses
from gva_mi.fit.samples import SampleTarget
from gva_mi.splat import Camera, Image
from gva_mi.subject.crop import Box

ALL = LossOptions(perceptual=0.3, residual=0.7, alpha=0.2, ssim=0.4)
H, W = 16, 20


@pytest.fixture
def generator():
    return torch.Generator().manual_seed(0)


def picture(generator):
    return torch.randint(256, (H, W, 3), generator=generator) / 255


def target_of(color, window=None):
    """A person who fills the picture."""
    whole = Box(0, 0, W, H)
    person = torch.full((H, W, 4), 255, dtype=torch.uint8)
    person[..., :3] = (255 * color).round().to(torch.uint8)
    cutout = Cutout(person, torch.zeros_like(person), whole, torch.zeros(3))
    camera = look_from_afar(W, H)
    return SampleTarget(cutout, whole, camera, window or whole, H * W)


def look_from_afar(width, height):
    return Camera(30, 30, width / 2, height / 2, np.eye(4), width, height)


def render_of(color, alpha):
    return Image(color, alpha, torch.zeros_like(alpha))


def mean_square(image, target):
    return (image - target).square().mean()


def test_a_perfect_render_without_residual_costs_nothing(generator):
    target, mask = picture(generator), torch.ones(H, W)
    image = render_of(target, mask)
    losses = render_losses(image, target_of(target), torch.zeros(5, 3), ALL, mean_square)
    assert float(losses.total(ALL)) == pytest.approx(0, abs=1e-6)


def test_the_default_is_equation_9(generator):
    target, mask = picture(generator), torch.ones(H, W)
    color, residual = picture(generator), torch.randn(7, 3, generator=generator)
    image = render_of(color, 0.3 * mask)  # the background is black
    losses = render_losses(image, target_of(target), residual, LossOptions(), mean_square)
    expected = (
        (color - target).abs().mean()
        + 0.1 * mean_square(color, target)
        + 0.5 * residual.abs().mean()
    )
    assert torch.allclose(losses.total(LossOptions()), expected)
    often = expected + 3 * LossOptions().perceptual * losses.perceptual
    assert torch.allclose(losses.total(LossOptions(), perceptual_every=4), often)


@pytest.mark.parametrize("term", ["perceptual", "residual", "alpha", "ssim"])
def test_each_weight_scales_its_own_term(term, generator):
    target, mask = picture(generator), torch.ones(H, W)
    image = render_of(picture(generator), 0.5 * mask)
    residual = torch.randn(7, 3, generator=generator)
    off = dict.fromkeys(["perceptual", "residual", "alpha", "ssim"], 0.0)
    once, twice = LossOptions(**off | {term: 1.0}), LossOptions(**off | {term: 2.0})
    losses = render_losses(image, target_of(target), residual, once, mean_square)
    assert getattr(losses, term) > 0
    assert torch.allclose(losses.total(once), losses.recon + getattr(losses, term))
    assert torch.allclose(losses.total(twice), losses.recon + 2 * getattr(losses, term))


def test_the_window_confines_the_costly_terms(generator):
    target, mask = picture(generator), torch.ones(H, W)
    color = target.clone()
    color[:, :4] += 0.2  # outside the window
    target = target_of(target, window=Box(6, 0, 20, 16))
    losses = render_losses(render_of(color, mask), target, torch.zeros(0, 3), ALL, mean_square)
    assert losses.recon > 0 and losses.perceptual < 1e-12 and losses.ssim < 1e-6
