"""Samples of a step are reproducible and show everything that a render can change."""

import dataclasses

import numpy as np
import pytest
import torch

from gva_mi.fit.backgrounds import Cutout, composite_target
from gva_mi.fit.losses import LossOptions, render_losses
from gva_mi.fit.samples import FrameSampler, box_of_gaussians
from gva_mi.splat import Gaussians, Image, render
from gva_mi.subject.backdrop import behind, unsure
from gva_mi.subject.crop import Box

TRAIN = [0, 1, 2, 4, 5]


def samples(video, seed=0, window=16, mask_error=0.01, still_camera=False):
    return FrameSampler(video, TRAIN, seed, window, mask_error, still_camera)


def test_each_pass_shows_every_frame_once_in_another_order(video):
    found = samples(video)
    first, second = ([found[5 * p + k].frame for k in range(5)] for p in range(2))
    assert [found.frame(k) for k in range(10)] == first + second
    assert sorted(first) == sorted(second) == TRAIN and first != second


def test_a_step_draws_the_same_whatever_came_before_it(video):
    a, b = samples(video), samples(video)
    a[3], a[4]
    for step in (7, 2):
        x, y = a[step], b[step]
        assert x.frame == y.frame and x.window == y.window
        assert torch.equal(x.cutout.color, y.cutout.color)
        assert torch.equal(x.cutout.person, y.cutout.person)


def test_away_from_the_outline_the_person_is_cut_out_onto_the_background(video):
    sample = samples(video, mask_error=0.03)[0]
    frame = video[sample.frame]
    target = sample.target(everywhere(frame.camera))
    sure = ~unsure(frame.mask, 0.03 * sample.area**0.5)
    inside, outside = sure & (frame.mask == 1), sure & (frame.mask == 0)
    assert min(x.sum() for x in (inside, outside, ~sure)) > 100
    color, background, mask, _ = (x.numpy() for x in target.composite())
    np.testing.assert_allclose(color[inside], frame.image[inside], atol=1e-6)
    for x in (color[outside], background[sure]):
        np.testing.assert_allclose(x, np.broadcast_to(sample.cutout.color, x.shape), atol=1e-6)
    np.testing.assert_allclose(color[~sure], frame.image[~sure], atol=1e-6)
    kept = np.rint(255 * behind(frame.image, frame.mask)) / 255
    np.testing.assert_allclose(background[~sure], kept[~sure], atol=1e-6)
    np.testing.assert_allclose(mask, frame.mask, atol=1e-6)


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
        costs.append(float(target.errors(truth)[0]) * target.area / 48**2)
    assert costs[0] < 0.002 < 0.01 < costs[1]


def test_a_caption_teaches_nothing(video, monkeypatch):
    overlay = np.zeros((48, 48), bool)
    overlay[30:36, 10:40] = True
    captioned = [
        dataclasses.replace(
            frame, overlay=overlay, image=np.where(overlay[..., None], np.float32(1), frame.image)
        )
        for frame in video.frames()
    ]
    monkeypatch.setattr(type(video), "frames", lambda self, ks: iter([captioned[k] for k in ks]))
    sample = samples(video, window=48)[0]
    target, cut_out = sample.target(everywhere(video.cameras[0])), np.zeros((48, 48), bool)
    sample.cutout.box.cut(cut_out)[:] = True
    overlay &= cut_out
    assert overlay.sum() > 30
    color, alpha = torch.rand(48, 48, 3), torch.rand(48, 48)
    image = Image(color.requires_grad_(), alpha.requires_grad_())
    seen, wanted = target.in_window(image)
    assert torch.equal(seen[overlay], wanted[overlay])
    options = LossOptions(perceptual=0, ssim=1, alpha=1)
    losses = render_losses(image, target, torch.zeros(0, 3), options, None)
    sum((losses.recon, losses.ssim, losses.alpha)).backward()
    for x in (color.grad, alpha.grad):
        assert not x[overlay].any() and x[~overlay].any()


@pytest.mark.parametrize("still", [True, False])
def test_a_gap_in_the_person_shows_what_other_frames_show_there(still, video, monkeypatch):
    """A dark stripe of the wall, seen only where the person of other frames is not.

    If the camera moves, the stripe is elsewhere in those frames, and the nearest colour is used.
    """
    wall, stripe, person = np.float32([[0.9, 0.9, 0.8], [0.3, 0.1, 0.1], [0.1, 0.2, 0.9]])
    frames = []
    for k in range(max(TRAIN) + 1):
        picture = np.broadcast_to(wall, (48, 48, 3)).copy()
        row = 24 if still else 8 * k % 32
        picture[row : row + 4] = stripe
        mask = np.zeros((48, 48), np.float32)
        for left in (8 + 5 * k, 16 + 5 * k):  # two legs, and a gap of two columns
            mask[10:40, left : left + 6] = 1
        picture[mask > 0] = person
        frames.append(dataclasses.replace(video[k], image=picture, mask=mask))
    monkeypatch.setattr(
        type(video), "frames", lambda self, indices: iter([frames[k] for k in indices])
    )
    sample = samples(video, mask_error=0.06, still_camera=True)[0]
    k = sample.frame
    found = sample.target(everywhere(frames[k].camera)).composite()
    background = found.background.numpy()
    row = slice(25, 27) if still else slice(8 * k % 32 + 1, 8 * k % 32 + 3)
    gap = background[row, 14 + 5 * k : 16 + 5 * k]
    stripe_is_known = np.abs(gap - stripe).max() < 0.02
    assert stripe_is_known == still


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
    sizes = [target.part.width * target.part.height for target in (whole, part)]
    assert sizes[1] < sizes[0] == 48 * 48
    found = []
    for target in (whole, part):
        options = LossOptions(alpha=0.1, ssim=0.1)
        losses = render_losses(
            render(g, target.camera), target, torch.zeros(0, 3), options,
            lambda a, b: (a - b).square().mean(),
        )  # fmt: skip
        total = losses.total(options)
        found.append([total.detach(), *torch.autograd.grad(total, g.means, allow_unused=True)])
    for a, b in zip(*found, strict=True):
        assert (a is None) == (b is None)
        torch.testing.assert_close(a, b, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("shape", [(48, 48), (13, 21)])
def test_the_errors_and_their_gradients_are_those_of_their_equations(shape, video):
    """Also in a part that is no whole number of tiles, and beyond the cut-out."""
    sample = samples(video, mask_error=0.03)[2]
    part = Box(2, 1, 2 + shape[1], 1 + shape[0]) if shape != (48, 48) else Box(0, 0, 48, 48)
    target = dataclasses.replace(sample.target(everywhere(sample.camera)), part=part)
    generator = torch.Generator().manual_seed(0)
    color, alpha = (
        torch.rand(*shape, *rest, generator=generator).requires_grad_() for rest in ((3,), ())
    )
    wanted, background, mask, _ = target.composite()
    image = color + (1 - alpha)[..., None] * background
    of_mask = (alpha - mask).abs().sum() / target.area
    by_hand = (image - wanted).abs().sum() / (3 * target.area), of_mask
    errors = target.errors(Image(color, alpha))
    torch.testing.assert_close(errors, by_hand)
    for weights in ((2, 0), (1, 0.3), (0, 3)):
        found, expected = (
            torch.autograd.grad(
                sum(w * x for w, x in zip(weights, terms, strict=True) if w),
                (color, alpha), retain_graph=True, allow_unused=True,
            )
            for terms in (errors, by_hand)
        )  # fmt: skip
        for a, b in zip(found, expected, strict=True):
            assert (a is None) == (b is None)
            if a is not None:
                torch.testing.assert_close(a, b)


def test_the_part_that_is_drawn_holds_every_pixel_that_is(known, video):
    camera = video.cameras[0]
    generator = torch.Generator().manual_seed(0)
    for _ in range(20):
        means = known.canonical.means[:5] + torch.randn(5, 3, generator=generator)
        radius = 0.15 * float(torch.rand((), generator=generator))
        g = ball(means, radius)
        alpha = render(g, camera).alpha.clone()
        box = box_of_gaussians(g, camera)
        if box is not None:
            alpha[box.top : box.bottom, box.left : box.right] = 0
        assert alpha.max() == 0
    assert box_of_gaussians(ball(torch.tensor([[0.0, 50.0, 0.0]]), 0.01), camera) is None
    assert box_of_gaussians(ball(torch.full((1, 3), torch.nan), 0.01), camera) is None
    wide = ball(known.canonical.means[:1], float("inf"))
    assert box_of_gaussians(wide, camera) == Box(0, 0, 48, 48)


def test_a_part_is_composited_alike_after_parts_of_other_sizes():
    shape, generator = (40, 50, 4), torch.Generator().manual_seed(0)
    person, behind = (
        torch.randint(0, 256, shape, generator=generator).to(torch.uint8) for _ in range(2)
    )
    cutout = Cutout(person, behind, Box(0, 0, 50, 40), torch.tensor([0.2, 0.4, 0.6]))
    whole = composite_target(cutout, Box(0, 0, 50, 40))
    for seed in range(20):
        left, top = np.random.default_rng(seed).integers(0, 30, 2).tolist()
        part = composite_target(cutout, Box(left, top, 50, 40))
        for found, expected in zip(part, whole, strict=True):
            torch.testing.assert_close(found, expected[top:, left:], rtol=0, atol=0)
