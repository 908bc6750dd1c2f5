"""Samples of a step are reproducible and show everything that a render can change."""

import dataclasses

import numpy as np
import pytest
import torch

from gva_mi.data.backdrop import behind, unsure
from gva_mi.data.crop import Box
from gva_mi.fit.losses import LossOptions, render_losses
from gva_mi.fit.samples import FrameSampler, RandomStream, drawn, random_state, torch_state
from gva_mi.splat import Gaussians, Image, render

TRAIN = [0, 1, 2, 4, 5]


def samples(video, seed=0, random_background=True, window=16, mask_error=0.01):
    return FrameSampler(video, TRAIN, seed, random_background, window, mask_error)


def test_each_pass_shows_every_frame_once_in_another_order(video):
    found = samples(video)
    first, second = ([found[5 * p + k].frame for k in range(5)] for p in range(2))
    assert sorted(first) == sorted(second) == TRAIN and first != second


def test_a_step_draws_the_same_whatever_came_before_it(video):
    a, b = samples(video), samples(video)
    a[3], a[4]
    for step in (7, 2):
        x, y = a[step], b[step]
        assert x.frame == y.frame and x.window == y.window
        assert torch.equal(x.color, y.color) and torch.equal(x.person, y.person)


@pytest.mark.parametrize("random_background", [True, False])
def test_away_from_the_outline_the_person_is_cut_out_onto_the_background(random_background, video):
    sample = samples(video, random_background=random_background, mask_error=0.03)[0]
    frame = video[sample.frame]
    target = sample.target(everywhere(frame.camera))
    sure = ~unsure(frame.mask, 0.03 * sample.area**0.5)
    inside, outside = sure & (frame.mask == 1), sure & (frame.mask == 0)
    assert min(x.sum() for x in (inside, outside, ~sure)) > 100
    color, background = target.color.numpy(), target.background.numpy()
    np.testing.assert_allclose(color[inside], frame.image[inside], atol=1e-6)
    for x in (color[outside], background[sure]):
        np.testing.assert_allclose(x, np.broadcast_to(sample.color, x.shape), atol=1e-6)
    np.testing.assert_allclose(color[~sure], frame.image[~sure], atol=1e-6)
    kept = np.rint(255 * behind(frame.image, frame.mask)) / 255
    np.testing.assert_allclose(background[~sure], kept[~sure], atol=1e-6)
    np.testing.assert_allclose(target.mask.numpy(), frame.mask, atol=1e-6)
    assert random_background or bool((sample.color == 1).all())


@pytest.mark.parametrize("pixels", [-2, 2])
def test_a_perfect_render_costs_nothing_where_masks_are_off(pixels, video, monkeypatch):
    """Cutting by a mask that is too small or too large would penalise a perfect render."""
    y, x = np.mgrid[:48, :48] + 0.5
    alpha = (14.5 - np.hypot(x - 24, y - 24)).clip(0, 1).astype(np.float32)
    mask = (14.5 + pixels - np.hypot(x - 24, y - 24)).clip(0, 1).astype(np.float32)
    color, wall = np.float32([0.8, 0.3, 0.1]), np.float32([0.2, 0.4, 0.9])
    picture = alpha[..., None] * color + (1 - alpha[..., None]) * wall
    frame = dataclasses.replace(video[0], image=picture, mask=mask)
    monkeypatch.setattr(type(video), "frames", lambda self, indices: (frame for _ in indices))
    truth = Image(torch.from_numpy(alpha[..., None] * color), torch.from_numpy(alpha))
    costs = []
    for error in (0.12, 0.0):
        target = samples(video, mask_error=error)[0].target(everywhere(frame.camera))
        costs.append(float((target.before_background(truth).color - target.color).abs().mean()))
    assert costs[0] < 0.002 < 0.01 < costs[1]


def everywhere(camera):
    """One Gaussian that fills the picture."""
    x = np.linalg.inv(camera.T_camera_world) @ [0, 0, 3, 1]
    return ball(torch.from_numpy(x[:3]).float()[None], 5.0)


def ball(means, radius):
    count = len(means)
    return Gaussians(
        means, torch.tensor([[1.0, 0, 0, 0]]).expand(count, 4).contiguous(),
        torch.full((count, 3), radius), torch.full((count,), 0.9), colors=torch.rand(count, 3),
    )  # fmt: skip


@pytest.mark.parametrize("shift", [0.0, 0.5, 9.0, float("nan")])
def test_a_part_of_the_picture_costs_what_the_whole_does(shift, video, known):
    """Also where Gaussians stray from the person, leave the picture, or lie behind the camera."""
    sample = samples(video)[1]
    g = known(video.pose[sample.frame])
    behind = torch.tensor(np.linalg.inv(sample.camera.T_camera_world)[:3, 3]).float()
    means = g.means + torch.tensor([shift, 0, 0]) if shift == shift else behind.expand_as(g.means)
    g = dataclasses.replace(g, means=means.clone().requires_grad_())
    part = sample.target(g)
    whole = sample.target(everywhere(sample.camera))
    assert whole.mask.shape == (48, 48) and part.mask.numel() < 48 * 48
    found = []
    for target in (whole, part):
        image = target.before_background(render(g, target.camera))
        losses = render_losses(
            image, target.color, target.mask, torch.zeros(0, 3), LossOptions(alpha=0.1, ssim=0.1),
            lambda a, b: (a - b).square().mean(), target.window, sample.area,
        )  # fmt: skip
        total = losses.total(LossOptions(alpha=0.1, ssim=0.1))
        found.append([total.detach(), *torch.autograd.grad(total, g.means, allow_unused=True)])
    for a, b in zip(*found, strict=True):
        assert (a is None) == (b is None)
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-6)


def test_the_part_that_is_drawn_holds_every_pixel_that_is(known, video):
    camera = video.cameras[0]
    generator = torch.Generator().manual_seed(0)
    for _ in range(20):
        means = known.canonical.means[:5] + torch.randn(5, 3, generator=generator)
        radius = 0.15 * float(torch.rand((), generator=generator))
        g = ball(means, radius)
        alpha = render(g, camera).alpha.clone()
        box = drawn(g, camera)
        if box is not None:
            alpha[box.top : box.bottom, box.left : box.right] = 0
        assert alpha.max() == 0
    assert drawn(ball(torch.tensor([[0.0, 50.0, 0.0]]), 0.01), camera) is None
    assert drawn(ball(torch.full((1, 3), torch.nan), 0.01), camera) is None
    wide = ball(known.canonical.means[:1], float("inf"))
    assert drawn(wide, camera) == Box(0, 0, 48, 48)


@pytest.mark.parametrize("window", [11, 100])
def test_windows_lie_in_the_image_and_in_the_person_s_box(window, video):
    found = samples(video, window=window)
    for step in range(20):
        sample, where = found[step], found[step].window
        assert 0 <= where.left and 0 <= where.top and where.right <= 48 and where.bottom <= 48
        assert where.width == where.height == min(window, 48)
        mask = sample.target(everywhere(sample.camera)).mask
        assert mask.amax(1)[where.top : where.bottom].max() > 0.5
        assert mask.amax(0)[where.left : where.right].max() > 0.5


def test_purposes_and_steps_have_streams_of_their_own():
    drawn = {(p, k): random_state(0, p, k).random() for p in RandomStream for k in range(3)}
    assert len(set(drawn.values())) == len(drawn)
    assert (
        torch_state(0, RandomStream.SEED).initial_seed()
        != torch_state(1, RandomStream.SEED).initial_seed()
    )
