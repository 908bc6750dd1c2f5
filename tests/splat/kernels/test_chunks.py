"""Wide colours are composited in chunks to one picture."""

import pytest
import torch

from gva_mi.splat import Screen, render
from gva_mi.splat.gaussians import Gaussians
from gva_mi.splat.kernels import chunks
from gva_mi.splat.scene import random_scene

CHUNK = chunks.CHUNK


def scene(channels):
    return random_scene(torch.Generator().manual_seed(0), channels=channels).to(torch.float64)


@pytest.mark.parametrize("channels", [CHUNK, 33])
def test_every_channel_equals_a_picture_of_that_channel_alone(channels):
    s = scene(channels)
    g = s.gaussians
    with torch.no_grad():
        wide = render(g, s.camera, s.options, s.background)
        for c in (0, CHUNK - 1, channels - 1):
            one = Gaussians(g.means, g.quats, g.scales, g.opacities, g.colors[:, c : c + 1])
            image = render(one, s.camera, s.options, s.background[c : c + 1])
            torch.testing.assert_close(wide.color[..., c], image.color[..., 0], atol=1e-15, rtol=0)
            torch.testing.assert_close(wide.alpha, image.alpha, atol=0, rtol=0)
            torch.testing.assert_close(wide.depth, image.depth, atol=0, rtol=0)


def test_absolute_gradients_see_all_channels_at_once():
    """Two halves of the channels that cancel in every pixel have no absolute gradient either."""
    s = scene(2 * CHUNK)
    sign = torch.ones(2 * CHUNK, dtype=torch.float64)
    sign[CHUNK:] = -1
    colors = s.gaussians.colors.detach()[:, :1].expand(-1, 2 * CHUNK).contiguous().requires_grad_()
    g = s.gaussians
    screen = Screen(absolute=True)
    g = Gaussians(g.means, g.quats, g.scales, g.opacities, colors)
    (render(g, s.camera, screen=screen).color * sign).sum().backward()
    assert screen.absgrad.abs().max() < 1e-12
